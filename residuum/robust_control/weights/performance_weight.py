"""A performance weight with a monotone gain: high at low frequency, crossing 0 dB once."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput
from residuum.identification.linear_models.error_bounds.magnitude_fit import fit_magnitude
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.nearest_names import known_names
from residuum.robust_control.loop import Loop, Weights
from residuum.robust_control.synthesis.constrained_structure import (
    ControllerStructure,
    Point,
    bisected_front,
    preferred,
)
from residuum.robust_control.synthesis.structured_synthesis import Synthesis, synthesise

# The second-order reference model of a closed loop, and the performance weight that it implies.


@dataclass(frozen=True)
class ReferenceModel:
    """T_d(s) = ω_n²/(s² + 2ξω_n s + ω_n²), from overshoot and settling time; (2.30), (2.31).

    ξ = |ln o|/√(π² + ln² o),   ω_n = 4/(ξ ℓ)    (the printed (2.31b) reads ω_n ℓ ξ = 4)

    Parameters
    ----------
    overshoot : float
        o, 0 < o < 1 (0.01 = 1 %).
    settling_time : float
        ℓ [s], into 2 %.

    Raises
    ------
    BadInput
        Outside these ranges.
    """

    overshoot: float
    settling_time: float

    def __post_init__(self) -> None:
        if not 0 < self.overshoot < 1:
            raise BadInput(
                f"ReferenceModel, overshoot: is {self.overshoot!r}; must lie between 0 and 1"
            )
        if not (math.isfinite(self.settling_time) and self.settling_time > 0):
            raise BadInput(
                f"ReferenceModel, settling_time: is {self.settling_time!r}; must be a positive"
                " number of seconds"
            )

    @property
    def damping(self) -> float:
        """ξ."""
        return abs(math.log(self.overshoot)) / math.hypot(math.pi, math.log(self.overshoot))

    @property
    def natural_frequency(self) -> float:
        """ω_n [rad/s]."""
        return 4.0 / (self.damping * self.settling_time)

    @property
    def bandwidth(self) -> float:
        """ω_c = ω_n √(√(4ξ⁴ + 1) − 2ξ²) [rad/s], where the open loop T_d/(1 − T_d) crosses 0 dB."""
        return self.natural_frequency * _crossing(self.damping)

    def transfer_function(self) -> TransferFunction:
        """T_d(s)."""
        w = self.natural_frequency
        return TransferFunction(np.array([w * w]), np.array([1.0, 2 * self.damping * w, w * w]))

    def weight_magnitude(self, omega: npt.ArrayLike) -> FloatArray:
        """|W_S(jω)| = |1 − T_d(jω)|⁻¹, (2.32); it grows without bound towards ω = 0, where a loop
        needs an integrator.
        """
        return np.asarray(
            1.0 / np.abs(1.0 - self.transfer_function().frequency_response(omega)), dtype=float
        )


def shortest_settling_time(overshoot: float, critical_frequency: float) -> float:
    """ℓ_min [s]: the settling time whose reference model crosses 0 dB at `critical_frequency`
    [rad/s]; step 2 of Algorithm 2.
    """
    damping = ReferenceModel(overshoot, 1.0).damping
    return 4.0 * _crossing(damping) / (damping * critical_frequency)


def _crossing(damping: float) -> float:
    return math.sqrt(math.sqrt(4 * damping**4 + 1) - 2 * damping**2)


# Algorithm 2: the fastest closed loop with the least overshoot that stays robustly stable.

_Meets = Callable[[float, float, Synthesis | None], Synthesis | None]
_WISHES = ("overshoot", "settling-time")


@dataclass(frozen=True)
class NominalAim:
    """What the user asks: least overshoot that is worth having, longest settling time [s], slack γ
    of (2.35b).

    `overshoots` and `settling_times` are the grid's numbers; the step to the first infeasible
    settling time is then halved `halvings` times. `only` = "overshoot" or "settling-time" lets that
    wish alone choose the point of the front (Remark 2.7).

    Raises BadInput outside 0 < o_min < 1, ℓ_max > 0, γ > 0, or for another wish.
    """

    smallest_overshoot: float = 0.01
    longest_settling_time: float = 5.0
    slack: float = 0.1
    overshoots: int = 8
    settling_times: int = 192
    halvings: int = 4
    only: str | None = None

    def __post_init__(self) -> None:
        if self.only not in (None, *_WISHES):
            raise BadInput(
                f"NominalAim, only: is {self.only!r};"
                f" {known_names(self.only, _WISHES, 'must be one of')}"
            )
        if not (
            0 < self.smallest_overshoot < 1 and self.longest_settling_time > 0 and self.slack > 0
        ):
            raise BadInput(
                f"NominalAim: o_min = {self.smallest_overshoot!r} must lie between 0 and 1, l_max ="
                f" {self.longest_settling_time!r} and gamma = {self.slack!r} must be positive"
            )


@dataclass(frozen=True, eq=False)
class NominalDesign:
    """Result of Algorithm 2: Pareto front over (overshoot, settling time), the chosen point, its
    weight and controller.
    """

    front: tuple[Point[Synthesis], ...]
    chosen: Point[Synthesis]
    reference: ReferenceModel
    aim: NominalAim

    def weight(self, loop: Loop, order: int | None = None) -> TransferFunction:
        """Ŵ_S(z): a stable, proper fit of |1 − T_d|⁻¹ on the grid (steps 8, 9)."""
        magnitude = self.reference.weight_magnitude(loop.omega)
        return fit_magnitude(
            loop.omega, magnitude, order=order, bound="at", sample_time=loop.sample_time
        )


class Infeasible(BadInput):
    """No controller of the structure meets even the most modest aim; the message names the
    constraint and its frequency.
    """


def design_for_nominal_performance(
    loop: Loop,
    W_T: FloatArray,
    structure: ControllerStructure,
    aim: NominalAim,
    critical_frequency: float,
) -> NominalDesign:
    """Solve (2.35): minimise overshoot and settling time subject to min_ρ ‖[W_S S; W_T T]‖∞ < 1 +
    γ.

    Parameters
    ----------
    loop : Loop
        The nominal plant on its grid.
    W_T : array, shape (k,)
        |Ŵ_T| on the grid.
    critical_frequency : float
        Where |Ŵ_T| crosses 0 dB [rad/s] (π/Ts when it does not); it sets the shortest settling
        time.

    Raises
    ------
    Infeasible
        Even the longest settling time with the largest overshoot cannot be met; says by how much,
        and at which frequency.

    Notes
    -----
    For a given overshoot a longer settling time moves |W_S| to lower frequencies, which asks less:
    feasibility is monotone in ℓ, and a bisection for each overshoot replaces the source's genetic
    search. It is not monotone in the overshoot: at one settling time a larger overshoot means a
    larger ω_n and so a higher gain at low frequency.
    """
    fastest = shortest_settling_time(aim.smallest_overshoot, critical_frequency)
    if fastest >= aim.longest_settling_time:
        raise Infeasible(
            f"aim: the uncertainty allows settling in {fastest:.4g} s at best; "
            f"the longest asked for is {aim.longest_settling_time:.4g} s"
        )
    overshoots = np.geomspace(0.5, aim.smallest_overshoot, aim.overshoots)
    # From modest to ambitious, the order in which a front is bisected.
    times = np.geomspace(aim.longest_settling_time, fastest, aim.settling_times)
    limit = 1.0 + aim.slack
    worst: list[Synthesis] = []

    def meets(overshoot: float, settling_time: float, warm: Synthesis | None) -> Synthesis | None:
        W_S = ReferenceModel(overshoot, settling_time).weight_magnitude(loop.omega)
        design = _best(loop, Weights(W_S, W_T), structure, warm, limit)
        worst.append(design)
        return design if design.certified < limit and design.stable else None

    front = bisected_front([float(o) for o in overshoots], [float(t) for t in times], meets)
    if not front:
        raise Infeasible(_reason(loop, W_T, worst[-1], limit))
    front = [_sharpened(point, times, meets, aim.halvings) for point in front]
    span = (1.0, aim.longest_settling_time - fastest)
    only = None if aim.only is None else _WISHES.index(aim.only)
    chosen = preferred(front, (aim.smallest_overshoot, fastest), span, only)
    reference = ReferenceModel(chosen.first, chosen.second)
    polished = refined(loop, Weights(reference.weight_magnitude(loop.omega), W_T), chosen)
    return NominalDesign(tuple(front), polished, reference, aim)


def _sharpened(
    point: Point[Synthesis], times: FloatArray, meets: _Meets, halvings: int
) -> Point[Synthesis]:
    """The point with its settling time moved towards the grid's next one, as far as that stays
    feasible.
    """
    shorter = times[times < point.second * (1.0 - 1e-9)]
    if not len(shorter):
        return point
    beyond = float(shorter[0])
    for _ in range(halvings):
        # Half-way by ratio, as the grid of times is.
        between = float(np.sqrt(point.second * beyond))
        design = meets(point.first, between, point.design)
        if design is None:
            beyond = between
        else:
            point = replace(point, second=between, design=design)
    return point


def refined(loop: Loop, weights: Weights, chosen: Point[Synthesis]) -> Point[Synthesis]:
    """The chosen point with its cost minimised to the end; the search for the front stops as soon
    as a pair is feasible.
    """
    polished = synthesise(loop, weights, chosen.design.structure, starts=[chosen.design.rho])
    better = polished.stable and polished.certified < chosen.design.certified
    return replace(chosen, design=polished) if better else chosen


def _best(
    loop: Loop,
    weights: Weights,
    structure: ControllerStructure,
    warm: Synthesis | None,
    limit: float,
) -> Synthesis:
    """From a neighbour's controller when there is one, from scratch when that does not suffice."""
    if warm is not None:
        # The search ends a little below the limit: its certificate comes from a finer grid, on
        # which the cost may be larger.
        design = synthesise(loop, weights, structure, starts=[warm.rho], target=0.995 * limit)
        if design.certified < limit:
            return design
    return synthesise(loop, weights, structure, target=0.995 * limit)


def _reason(loop: Loop, W_T: FloatArray, nearest: Synthesis, limit: float) -> str:
    at = float(nearest.worst_frequency)
    k = int(np.argmin(np.abs(loop.omega - at)))
    K = nearest.controller.frequency_response(loop.omega[k : k + 1])
    T = loop.G[0, k] * K / (1.0 + loop.G[0, k] * K)
    limiting = (
        "robust stability |W_T T|"
        if abs(W_T[k] * T[0]) > 0.7 * nearest.certified
        else "performance |W_S S|"
    )
    return (
        f"aim: no controller {nearest.structure.name!r} meets it; at best the cost is"
        f" {nearest.certified:.4g} where {limit:.4g} is allowed, at {at:.4g} rad/s, by {limiting}"
    )


@dataclass(frozen=True)
class MonotoneWeight:
    """W(s) = (h s + a)/(s + a/l), |W(jω_c)| = 1.

    a = ω_c √((1 − h²)/(1 − l⁻²)) with gains l at ω = 0 and h at ω = ∞; used by Algorithm 3.

    Parameters
    ----------
    low_gain_db, high_gain_db : float
        20 lg l and 20 lg h; the one above, the other below 0 dB.
    critical_frequency : float
        ω_c [rad/s].
    """

    low_gain_db: float
    high_gain_db: float
    critical_frequency: float

    def __post_init__(self) -> None:
        if self.low_gain_db * self.high_gain_db >= 0:
            raise BadInput(
                f"MonotoneWeight: gains {self.low_gain_db} dB and {self.high_gain_db} dB; one must"
                " lie above 0 dB, one below"
            )
        if not (math.isfinite(self.critical_frequency) and self.critical_frequency > 0):
            raise BadInput(
                f"MonotoneWeight, critical_frequency: is {self.critical_frequency!r}; must be"
                " positive"
            )

    def transfer_function(self) -> TransferFunction:
        """W(s)."""
        low, high = 10 ** (self.low_gain_db / 20), 10 ** (self.high_gain_db / 20)
        a = self.critical_frequency * math.sqrt((1 - high**2) / (1 - low**-2))
        return TransferFunction(np.array([high, a]), np.array([1.0, a / low]))

    def magnitude(self, omega: npt.ArrayLike) -> FloatArray:
        """|W(jω)|."""
        return np.abs(self.transfer_function().frequency_response(omega))
