"""Certificates: norms and margins computed anew from the closed loop."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats
from scipy.linalg import eigvals
from scipy.signal import lfilter

from residuum.array_types import ComplexArray, FloatArray
from residuum.identification.blas_threads import LARGEST_FOR_ONE_THREAD, one_thread_if_small
from residuum.identification.errors import BadInput
from residuum.identification.linear_models.state_space import StateSpace
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.nearest_names import known_names
from residuum.robust_control.loop import Loop, Weights, characteristic, frequency_grid
from residuum.robust_control.synthesis.constrained_structure import (
    ControllerStructure,
    Point,
    bisected_front,
    preferred,
)
from residuum.robust_control.synthesis.structured_synthesis import Synthesis, synthesise
from residuum.robust_control.weights.performance_weight import Infeasible, MonotoneWeight, refined

# Disk margins: gain and phase that may vary together before the loop becomes unstable.


@dataclass(frozen=True)
class DiskMargin:
    """`alpha` is the disk's size; gain may vary within (`gain_low`, `gain_high`), phase within ±
    `phase` [rad], at once or alone.

    `frequency` [rad/s] is where the loop is nearest to the disk.
    """

    alpha: float
    gain_low: float
    gain_high: float
    phase: float
    frequency: float


def disk_margin(
    plant: TransferFunction, controller: TransferFunction, *, skew: float = 0.0
) -> DiskMargin:
    """α = 1/‖S + (σ − 1)/2‖∞ for the perturbations f = (1 + (1−σ)/2 δ)/(1 − (1+σ)/2 δ), |δ| < α.

    Parameters
    ----------
    skew : float
        σ: 0 weighs more and less gain alike, 1 uses S alone, −1 uses T alone.

    Raises
    ------
    BadInput
        The nominal loop is not stable: there is no margin.

    References
    ----------
    P. Seiler, A. Packard, P. Gahinet, *An introduction to disk margins*, IEEE Control Systems
    Magazine 40 (2020) 78–95.

    Examples
    --------
    >>> plant, K = TransferFunction([0.1], [1.0, -0.9], 1.0), TransferFunction([4.0], [1.0], 1.0)
    >>> margin = disk_margin(plant, K)
    >>> round(margin.gain_high, 3), bool(margin.phase > 1)
    (4.75, True)
    """
    omega, _, _, S = loop_responses(plant, controller)
    if not Loop([plant], omega).is_certainly_stable(controller):
        raise BadInput("disk margin: the nominal loop is not stable")
    distance = np.abs(S + (skew - 1.0) / 2.0)
    k = int(np.argmax(distance))
    alpha = 1.0 / float(distance[k])
    low = (2.0 - alpha * (1.0 - skew)) / (2.0 + alpha * (1.0 + skew))
    # Without room the disk reaches infinity: the gain may rise without limit.
    room = 2.0 - alpha * (1.0 + skew)
    high = (2.0 + alpha * (1.0 - skew)) / room if room > 1e-12 else math.inf
    cosine = low if math.isinf(high) else (1.0 + low * high) / (low + high)
    # Rounding may carry a cosine beyond 1.
    return DiskMargin(alpha, low, high, math.acos(min(1.0, max(-1.0, cosine))), float(omega[k]))


def loop_responses(
    plant: TransferFunction, controller: TransferFunction
) -> tuple[FloatArray, ComplexArray, ComplexArray, ComplexArray]:
    """(ω, G, K, S) on a grid dense about the plant's and the closed loop's resonances."""
    closed = TransferFunction(plant.den, characteristic(plant, controller), plant.sample_time)
    omega = frequency_grid([plant, closed], points=4000)
    G, K = plant.frequency_response(omega), controller.frequency_response(omega)
    return omega, G, K, 1.0 / (1.0 + G * K)


# The H∞ norm of a discrete-time system from the eigenvalues of a symplectic pencil, not from a
# grid.

_ITERATIONS = 60  # at most; levels converge quadratically
_NEAR_CIRCLE = 1e-4  # distance of an eigenvalue from the unit circle that counts as a crossing


@one_thread_if_small(LARGEST_FOR_ONE_THREAD)
def h_infinity_norm(system: StateSpace, *, tolerance: float = 1e-8) -> tuple[float, float]:
    r"""(upper bound of ‖H‖∞, normalised frequency θ = ω Ts [rad] of the peak).

    γ is a singular value of H at e^{jθ} exactly when e^{jθ} is an eigenvalue of the symplectic
    pencil

    .. math::
        \begin{bmatrix} \bar A & 0 \\ -C^T(C + D R^{-1} D^T C) & I \end{bmatrix} - \lambda
        \begin{bmatrix} I & -B R^{-1} B^T \\ 0 & \bar A^T \end{bmatrix}, \qquad
        \bar A = A + B R^{-1} D^T C, \quad R = \gamma^2 I - D^T D

    so a level without eigenvalues on the unit circle lies above the norm. Levels are raised to the
    largest gain between neighbouring crossings, which converges quadratically.

    Parameters
    ----------
    system : StateSpace
        Stable.
    tolerance : float
        Relative gap between the returned bound and a gain that was reached.

    Raises
    ------
    BadInput
        The system is not stable: its norm is infinite.

    Notes
    -----
    Eigenvalues within 1e-4 of the circle count as possible crossings and are examined by the gain
    there, so rounding adds candidates and loses none unless it moves an eigenvalue by more than
    that.

    References
    ----------
    N. A. Bruinsma, M. Steinbuch, *A fast algorithm to compute the H∞-norm of a transfer function
    matrix*, Systems & Control Letters 14 (1990) 287–293; the pencil for discrete time: B.
    Hinrichsen, N. K. Son, *Stability radii of linear discrete-time systems and symplectic pencils*,
    Int. J. Robust Nonlinear Control 1 (1991) 79–97.

    Examples
    --------
    >>> lag = StateSpace(np.array([[0.5]]), np.eye(1), np.eye(1), np.zeros((1, 1)), sample_time=1.0)
    >>> round(h_infinity_norm(lag)[0], 6)
    2.0
    """
    poles = np.linalg.eigvals(system.A)
    if np.any(np.abs(poles) >= 1.0):
        raise BadInput(
            "H-infinity norm: the system is not stable, its largest pole has modulus"
            f" {np.abs(poles).max():.9g}"
        )
    # near lightly damped poles the gain has its peaks: a high first level saves iterations
    angles = np.unique(
        np.abs(np.concatenate([np.angle(poles), np.geomspace(1e-6, np.pi, 60), [0.0]]))
    )
    lower, peak = _largest(system, angles)
    if lower == 0.0:
        return 0.0, 0.0
    for _ in range(_ITERATIONS):
        level = lower * (1.0 + 2.0 * tolerance)
        crossings = _crossings(system, level)
        ends = np.unique(np.concatenate([[0.0, np.pi], crossings]))
        # between two crossings the gain lies above the level or below it throughout
        gain, at = _largest(system, np.concatenate([ends, 0.5 * (ends[1:] + ends[:-1])]))
        if gain <= level:
            return level, peak
        lower, peak = gain, at
    return lower * (1.0 + 2.0 * tolerance), peak


def _largest(system: StateSpace, angles: FloatArray) -> tuple[float, float]:
    gains = np.linalg.norm(system.response(np.exp(1j * angles)), ord=2, axis=(1, 2))
    k = int(np.argmax(gains))
    return float(gains[k]), float(angles[k])


def _crossings(system: StateSpace, level: float) -> FloatArray:
    """Angles in [0, π] of the pencil's eigenvalues near the unit circle."""
    A, B, C, D = system.A, system.B, system.C, system.D
    n = len(A)
    R = level**2 * np.eye(B.shape[1]) - D.T @ D
    closed = A + B @ np.linalg.solve(R, D.T @ C)
    output = C.T @ (C + D @ np.linalg.solve(R, D.T @ C))
    zero = np.zeros((n, n))
    left = np.block([[np.eye(n), -B @ np.linalg.solve(R, B.T)], [zero, closed.T]])
    right = np.block([[closed, zero], [-output, np.eye(n)]])
    roots = eigvals(right, left)
    # A left side that is singular has eigenvalues at infinity.
    roots = roots[np.isfinite(roots) & (np.abs(np.abs(roots) - 1.0) < _NEAR_CIRCLE)]
    return np.unique(np.abs(np.angle(roots)))


# Algorithm 3: the most demanding monotone performance weight that every plant of the uncertainty
# set meets.

_WISHES = ("high-gain", "critical-frequency")


@dataclass(frozen=True)
class RobustAim:
    """Gains [dB] and frequencies [rad/s] between which W_S is sought: l_g, h_g in [h_min, h_max]
    and ω_c from ω_c,min on.

    `only` = "high-gain" or "critical-frequency" lets that wish alone choose the point of the front
    (Remark 2.7).

    Raises BadInput when h_min ≥ h_max, h_max ≥ 0, l_g ≤ 0 or ω_c,min ≤ 0.
    """

    low_gain_db: float = 120.0
    smallest_high_gain_db: float = -50.0
    largest_high_gain_db: float = -0.5
    lowest_critical_frequency: float = 1.0
    high_gains: int = 8
    critical_frequencies: int = 192
    only: str | None = None

    def __post_init__(self) -> None:
        if self.only not in (None, *_WISHES):
            raise BadInput(
                f"RobustAim, only: is {self.only!r};"
                f" {known_names(self.only, _WISHES, 'must be one of')}"
            )
        ordered = self.smallest_high_gain_db < self.largest_high_gain_db < 0 < self.low_gain_db
        if not (ordered and self.lowest_critical_frequency > 0):
            raise BadInput(
                "RobustAim: needs h_min < h_max < 0 dB < l_g and a positive lowest critical"
                " frequency"
            )


@dataclass(frozen=True, eq=False)
class RobustDesign:
    """Result of Algorithm 3: Pareto front over (h_g [dB], ω_c [rad/s]), the chosen point and its
    weight.
    """

    front: tuple[Point[Synthesis], ...]
    chosen: Point[Synthesis]
    weight: MonotoneWeight
    aim: RobustAim


def design_for_robust_performance(
    loop: Loop,
    W_T: FloatArray,
    structure: ControllerStructure,
    aim: RobustAim,
    critical_frequency: float,
) -> RobustDesign:
    """Solve (2.37): maximise ω_c and h_g subject to max_ω |W_S S| + |W_T T| < 1.

    The controller minimises that very sum (the source minimises the mixed-sensitivity norm and then
    checks the sum, which is never better).

    Raises
    ------
    Infeasible
        Not even the lowest critical frequency with the smallest high-frequency gain can be met.
    """
    if aim.lowest_critical_frequency >= critical_frequency:
        raise Infeasible(
            f"aim: lowest critical frequency {aim.lowest_critical_frequency:.4g} rad/s is not below"
            f" that of the uncertainty, {critical_frequency:.4g} rad/s"
        )
    gains = np.linspace(aim.smallest_high_gain_db, aim.largest_high_gain_db, aim.high_gains)
    frequencies = np.geomspace(
        aim.lowest_critical_frequency, critical_frequency, aim.critical_frequencies
    )
    tried: list[Synthesis] = []

    def meets(high_gain: float, frequency: float, warm: Synthesis | None) -> Synthesis | None:
        W_S = MonotoneWeight(aim.low_gain_db, high_gain, frequency).magnitude(loop.omega)
        weights = Weights(W_S, W_T, "1")
        starts = None if warm is None else [warm.rho]
        design = synthesise(loop, weights, structure, starts=starts, target=0.995)
        # a search from its neighbour's end may be stuck where one from the starts is not
        if warm is not None and design.certified >= 1.0:
            design = synthesise(loop, weights, structure, target=0.995)
        tried.append(design)
        return design if design.certified < 1.0 and design.stable else None

    front = bisected_front(gains.tolist(), frequencies.tolist(), meets)
    if not front:
        least = tried[-1]
        raise Infeasible(
            f"aim: no controller {structure.name!r} gives robust performance; at best |W_S S| +"
            f" |W_T T| is {least.certified:.4g} at {least.worst_frequency:.4g} rad/s where less"
            " than 1 is needed"
        )
    ideal = (aim.largest_high_gain_db, critical_frequency)
    span = (
        aim.largest_high_gain_db - aim.smallest_high_gain_db,
        critical_frequency - aim.lowest_critical_frequency,
    )
    chosen = preferred(front, ideal, span, None if aim.only is None else _WISHES.index(aim.only))
    weight = MonotoneWeight(aim.low_gain_db, chosen.first, chosen.second)
    return RobustDesign(
        tuple(front),
        refined(loop, Weights(weight.magnitude(loop.omega), W_T, "1"), chosen),
        weight,
        aim,
    )


# Step responses of a loop over sampled plants: overshoot, settling time, integral absolute error.


@dataclass(frozen=True)
class StepResponse:
    """Of one closed loop to a unit step of the reference.

    `overshoot` (0.1 = 10 %) and `settling_time` [s] into ±2 % of the final value 1 (infinite when
    it is not reached within the horizon), `integral_absolute_error` [s] = Ts Σ|1 − y|, (2.40) with
    its missing sample time.
    """

    overshoot: float
    settling_time: float
    integral_absolute_error: float


def step_response(
    plant: TransferFunction, controller: TransferFunction, duration: float
) -> FloatArray:
    """y of the closed loop T = GK/(1 + GK) for a unit step, shape (n,); grows without bound for an
    unstable loop.
    """
    return _unit_step(plant, controller, plant.num, duration)


def control_response(
    plant: TransferFunction, controller: TransferFunction, duration: float
) -> FloatArray:
    """u = K/(1 + GK) r, what the controller asks of the actuator for a unit step of the reference,
    shape (n,).
    """
    return _unit_step(plant, controller, plant.den, duration)


def _unit_step(
    plant: TransferFunction, controller: TransferFunction, path: FloatArray, duration: float
) -> FloatArray:
    """The unit step's response of `path` · K's numerator over the loop's characteristic
    polynomial.
    """
    n = max(2, round(duration / float(plant.sample_time or 0.0)))
    den = characteristic(plant, controller)
    num = np.polymul(path, controller.num)
    num = np.concatenate([np.zeros(len(den) - len(num)), num])
    # An unstable loop grows beyond all numbers, by which its figures are infinite.
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(lfilter(num, den, np.ones(n)), dtype=float)


def assess(y: FloatArray, sample_time: float) -> StepResponse:
    """The figures of a step response."""
    if not np.isfinite(y).all():
        return StepResponse(float("inf"), float("inf"), float("inf"))
    outside = np.flatnonzero(np.abs(y - 1.0) > 0.02)
    last = int(outside[-1]) + 1 if outside.size else 0
    settled = last * sample_time if last < len(y) else float("inf")
    return StepResponse(
        max(0.0, float(y.max() - 1.0)), settled, float(sample_time * np.abs(1.0 - y).sum())
    )


def over_plants(
    plants: Sequence[TransferFunction], controller: TransferFunction, duration: float
) -> list[StepResponse]:
    """The figures for every plant."""
    return [
        assess(step_response(plant, controller, duration), float(plant.sample_time or 0.0))
        for plant in plants
    ]


_NARROW = 0.1  # of an indicator's quantile, within which its confidence interval is sure enough
_OVERSHOOT_STEP = 0.005  # of overshoot, within which it is sure in any case


@dataclass(frozen=True)
class Measured:
    """Step responses of the nominal loop and of drawn plants, to be held against what was
    promised.
    """

    nominal: StepResponse
    drawn: tuple[StepResponse, ...]

    def reached_by(self, share: float) -> tuple[float, float]:
        """(overshoot, settling time [s]) that this share of the drawn plants stays below, each for
        itself.
        """
        return (
            float(np.quantile([step.overshoot for step in self.drawn], share, method="higher")),
            float(np.quantile([step.settling_time for step in self.drawn], share, method="higher")),
        )

    def is_sure_of(self, share: float, sample_time: float) -> bool:
        """Whether the 95 % intervals of both `reached_by` are narrow: a tenth of the value, else a
        sample, half a per cent.

        The interval of a quantile lies between two of the ordered values, whose ranks are those of
        a binomial law.
        """
        n = len(self.drawn)
        ranks = stats.binom.ppf([0.025, 0.975], n, share).astype(int)
        low, high = np.clip(ranks - [1, 0], 0, n - 1)
        for name, least in (("overshoot", _OVERSHOOT_STEP), ("settling_time", sample_time)):
            values = np.sort([getattr(step, name) for step in self.drawn])
            if values[low] < values[high] and not values[high] - values[low] <= max(
                _NARROW * values[low], 1.001 * least
            ):
                return False
        return True

    def kept(self, overshoot: float, settling_time: float) -> tuple[bool, float]:
        """Whether the nominal loop stays within both, and the share of the drawn plants that
        does.
        """

        def within(step: StepResponse) -> bool:
            return step.overshoot <= overshoot and step.settling_time <= settling_time

        return within(self.nominal), float(np.mean([within(step) for step in self.drawn]))


def measured(
    nominal: TransferFunction,
    plants: Sequence[TransferFunction],
    controller: TransferFunction,
    duration: float,
) -> Measured:
    """Follow the steps of the nominal loop and of every drawn plant for `duration` [s]."""
    first, *drawn = over_plants([nominal, *plants], controller, duration)
    return Measured(first, tuple(drawn))
