"""The gate actuator as a motor with a rigid transmission: constants, simulation, and adaptation to
one exemplar.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.ndimage import shift, uniform_filter1d
from scipy.optimize import least_squares
from scipy.signal import lfilter

from residuum.array_types import ComplexArray
from residuum.diagnosis.gate.movements import Movement, flat_part
from residuum.diagnosis.vibration.rotation import POINTS_OF_A_TURN
from residuum.identification.errors import BadInput, NotIdentifiable

# How much of the typical shaft turn looks like a notch in the gear, and not like the tooth errors
# of a healthy one.

Signal = npt.NDArray[np.float64]
# standard deviations of the bump in pitches of the gear: about the two teeth that spread
_WIDTHS = (0.6, 0.8, 1.0, 1.25)
_SMOOTHING = 3  # orders; over more, the steep power of the lowest orders leaks into the next


@dataclass(frozen=True, eq=False)
class NotchMatch:
    r"""Matched filter for one bump of the transmission error a shaft turn, in the coloured pattern
    of healthy teeth.

    A notch lets the teeth beside it spread: the transmission error e(φ) has a bump g(φ), about one
    gear pitch wide, once a turn. It accelerates the gate, and the drive's first-order lag T passes
    it on to the speed, so its spectrum at order k is S_k. (A gear that binds at one place loads the
    drive there: a pulse, which `periodic_pulse` of the movement's features looks for.)

    .. math:: S_k \propto \frac{s_k^2}{1 + s_k T} \, e^{-(k \sigma)^2 / 2}, \qquad s_k = j k
    \omega_M / N

    Healthy teeth make the typical turn a random pattern with power P_k (mean over healthy turns,
    smoothed over three orders). With z the largest whitened correlation over all places and widths,
    z = max |Σ 2 Re(S̄_k X_k e^{jkφ}/P_k)| / √(2 Σ|S_k|²/P_k), and v² what the turn scatters
    besides, as a multiple of what healthy turns do, the statistic is z / √max(1, v): z alone
    mistakes a gear that is worse all round for a notch, z / v a gear that is very good but for one
    tooth.

    Fails for a bump of another width than about 0.5 … 1.5 pitches, and for two notches.

    Attributes
    ----------
    power : array, shape (gear_teeth − 1,)
        P_k of the orders 1 … gear_teeth − 1 of the typical turn [(rad/s)²].
    gear_teeth : int
        N.
    """

    power: Signal
    gear_teeth: int

    @classmethod
    def of(cls, typical_turns: Sequence[Signal], gear_teeth: int) -> NotchMatch:
        """From the typical turns of healthy movements, each of shape (POINTS_OF_A_TURN,);
        NotIdentifiable without any.
        """
        if len(typical_turns) == 0:
            raise NotIdentifiable("notch match: no healthy turn to learn the tooth errors from")
        power = np.mean(
            [np.abs(_spectrum(turn, gear_teeth)) ** 2 for turn in typical_turns], axis=0
        )
        smooth = np.exp(
            uniform_filter1d(np.log(power + np.finfo(float).tiny), _SMOOTHING, mode="nearest")
        )
        return cls(np.asarray(smooth), gear_teeth)

    def statistic(self, typical_turn: Signal, motor_speed: float, time_constant: float) -> float:
        """z / √max(1, v) of one typical turn [standard deviations]; ω_M [rad/s], T [s]. About 3 for
        healthy gears.
        """
        X = self.spectrum(typical_turn)
        z, _ = self.largest_bump(X, motor_speed, time_constant)
        energy = 2.0 * float(np.sum(np.abs(X) ** 2 / self.power))
        variance = (energy - z**2) / (2 * len(self.power) - 1)
        return z / max(variance, 1.0) ** 0.25

    @property
    def orders(self) -> npt.NDArray[np.int64]:
        """Orders k = 1 … gear_teeth − 1 of the shaft, shape (gear_teeth − 1,)."""
        return np.arange(1, self.gear_teeth)

    def spectrum(self, typical_turn: Signal) -> ComplexArray:
        """X_k, the Fourier coefficients of a turn at these orders [unit of the turn], shape
        (gear_teeth − 1,).
        """
        return _spectrum(typical_turn, self.gear_teeth)

    def largest_bump(
        self, X: ComplexArray, motor_speed: float, time_constant: float
    ) -> tuple[float, ComplexArray]:
        """z of the bump that X_k matches best, and that bump, fitted, shape (gear_teeth − 1,)."""
        best, bump = 0.0, np.zeros_like(X)
        for S in self._bumps(motor_speed, time_constant):
            energy = 2.0 * float(np.sum(np.abs(S) ** 2 / self.power))
            correlation = self._correlation(X, S)
            place = int(np.argmax(np.abs(correlation)))
            z = float(np.abs(correlation[place])) / np.sqrt(energy)
            if z > best:
                turned = S * np.exp(-2j * np.pi * self.orders * place / POINTS_OF_A_TURN)
                best, bump = z, correlation[place] / energy * turned
        return best, bump

    def _bumps(self, motor_speed: float, T: float) -> list[ComplexArray]:
        k = self.orders
        s = 1j * k * motor_speed / self.gear_teeth
        return [
            s**2 / (1.0 + s * T) * np.exp(-0.5 * (k * width * 2 * np.pi / self.gear_teeth) ** 2)
            for width in _WIDTHS
        ]

    def _correlation(self, X: ComplexArray, S: ComplexArray) -> Signal:
        """Whitened correlation with the bump at each of POINTS_OF_A_TURN places, shape
        (POINTS_OF_A_TURN,).
        """
        weighted = np.zeros(POINTS_OF_A_TURN, dtype=complex)
        weighted[1 : self.gear_teeth] = np.conj(S) * X / self.power
        return np.asarray(2.0 * POINTS_OF_A_TURN * np.real(np.fft.ifft(weighted)))


def _spectrum(typical_turn: Signal, gear_teeth: int) -> ComplexArray:
    """Fourier coefficients of the orders 1 … gear_teeth − 1."""
    return np.asarray(np.fft.rfft(typical_turn)[1:gear_teeth] / POINTS_OF_A_TURN)


_STANDSTILL = (
    0.15  # of the flat speed: below it dry friction at standstill rules, which the model has not
)
_FIT_RATE = 100.0  # Hz
_FIRST_DELAY = 5e-3  # s, where the search starts
_LOAD_SHAPE = (
    3  # constant, slope and curvature of the load along the gate, and at least that many terms
)
_TURNS_A_TERM = 8  # of the shaft; 1.4 m of the source's gate, whose way is two of them


@dataclass(frozen=True)
class ActuatorConstants:
    """Constants of the data sheet (Valceschini, section 7.3); tooth numbers set the fault
    frequencies.

    Parameters
    ----------
    R : float
        Winding resistance [Ω].
    K : float
        Torque and voltage constant k_t = k_e [N·m/A = V·s/rad].
    J_M : float
        Inertia of the motor [kg·m²].
    gate_mass : float
        m [kg].
    gear_radius : float
        Primitive radius r of the nylon gear [m].
    gear_teeth, pinion_teeth : int
        Teeth of the nylon gear (the worm has one start, so it is also the ratio) and of the pinion.
    transmission : float or None
        τ̄ = v_M/ω_M [m/rad]; None takes r / gear_teeth. (The source prints r/47 beside 44 teeth;
        only 44 gives its fault frequency of 1.55 Hz at 4100 rpm.)

    >>> constants = ActuatorConstants()
    >>> round(constants.fault_frequency(4100 * 2 * np.pi / 60), 2)
    1.55
    >>> round(constants.time_constant, 4), round(constants.gain, 2)
    (0.0434, 14.37)
    """

    R: float = 0.7473
    K: float = 0.0696
    J_M: float = 3.5e-5
    gate_mass: float = 608.0
    gear_radius: float = 28e-3
    gear_teeth: int = 44
    pinion_teeth: int = 14
    transmission: float | None = None

    def __post_init__(self) -> None:
        for name in ("R", "K", "J_M", "gate_mass", "gear_radius", "gear_teeth", "pinion_teeth"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise BadInput(f"ActuatorConstants, {name}: is {value!r}; must be positive")

    @property
    def tau(self) -> float:
        """Transmission ratio τ̄ [m/rad]."""
        return (
            self.gear_radius / self.gear_teeth if self.transmission is None else self.transmission
        )

    @property
    def J(self) -> float:
        """Inertia at the motor J = J_M + τ̄²m [kg·m²]."""
        return self.J_M + self.tau**2 * self.gate_mass

    @property
    def gain(self) -> float:
        """μ = 1/K of (7.2) [rad/(V·s)]."""
        return 1.0 / self.K

    @property
    def time_constant(self) -> float:
        """T = J R / K² of (7.2) [s]."""
        return self.J * self.R / self.K**2

    def fault_frequency(self, motor_speed: float) -> float:
        """Turns a second of the shaft that carries the nylon gear and the pinion [Hz] at ω_M
        [rad/s].
        """
        return motor_speed / (2.0 * np.pi * self.gear_teeth)


def first_order_response(u: Signal, T: float, sample_time: float, initial: float = 0.0) -> Signal:
    """Response of 1/(T s + 1) to u, straight between its samples, from y₀ = `initial`, shape (n,).

    Exact for the voltage's ramps; an input held between samples would shift the response by half a
    sample.
    """
    numerator, denominator = _first_order_hold(T, sample_time)
    zi = initial - numerator[0] * u[0]
    response, _ = lfilter(numerator, denominator, u, zi=[zi])
    return np.asarray(response)


def _first_order_hold(T: float, sample_time: float) -> tuple[list[float], list[float]]:
    """y_k = a y_{k−1} + b₀u_k + b₁u_{k−1} of 1/(T s + 1) when u is straight between samples."""
    a = float(np.exp(-sample_time / T))
    slope = (1.0 - a) * T / sample_time
    return [1.0 - slope, slope - a], [1.0, -a]


def delayed(u: Signal, delay: float, sample_time: float) -> Signal:
    """`u` later by `delay` seconds, its first value before.

    A cubic spline gives fractions of a sample: linear interpolation would smooth the pulse-width
    ripple between samples only, which pulls an estimated delay onto whole samples.
    """
    return np.asarray(shift(u, delay / sample_time, order=3, mode="nearest"))


@dataclass(frozen=True)
class AdaptedModel:
    r"""The source's model with the constants of one exemplar.

    .. math:: T \dot\omega + \omega = \mu V(t-d) - \ell(x)

    which is (7.2) and (7.4): with L = D = 0 the load torque τ_L acts as ℓ = τ_L R/K². A viscous
    friction D only changes μ and T; the load may vary slowly along the gate, ℓ(x) = ℓ₀ + ℓ₁x + ℓ₂x²
    over the travel x from 0 to 1. A gate longer than 20 turns of the shaft has a term more for
    every eight, ℓ_k cos kπx from k = 3: so its load is followed as finely in metres as that of a
    short one.

    Parameters
    ----------
    gain : float
        μ [rad/(V·s)].
    time_constant : float
        T [s].
    delay : float
        d [s].
    load : tuple of float
        ℓ₀, ℓ₁, ℓ₂, … [rad/s]; the travel counts in the direction of the movement.
    std : mapping of name to float
        Standard deviation of gain, time_constant and delay from the fit (white residual assumed:
        too small when it is coloured).
    """

    gain: float
    time_constant: float
    delay: float
    load: tuple[float, ...] = (0.0,)
    std: dict[str, float] = field(default_factory=dict, compare=False)

    def simulate(self, movement: Movement) -> Signal:
        """Motor speed ω̂_M [rad/s] of the model under the movement's voltage from its measured
        first speed, shape (n,).
        """
        V = delayed(movement.voltage, self.delay, movement.sample_time)
        load = _load_regressors(movement, len(self.load)) @ np.asarray(self.load)
        # dry friction stops the gate, it never drives it back
        drive = np.maximum(self.gain * V - load, 0.0)
        return first_order_response(
            drive, self.time_constant, movement.sample_time, movement.speed[0]
        )

    def residual(self, movement: Movement) -> Signal:
        """r = ω_M − ω̂_M [rad/s], shape (n,): the output error (7.5) before it is multiplied by
        τ̄.
        """
        return movement.speed - self.simulate(movement)


def from_data_sheet(
    constants: ActuatorConstants, delay: float = 0.0, friction_force: float | None = None
) -> AdaptedModel:
    """The model whose constants are all taken from the data sheet; friction force F_L [N], None
    takes m·g·3·10⁻⁴.
    """
    force = constants.gate_mass * 9.81 * 3e-4 if friction_force is None else friction_force
    load = force * constants.tau * constants.R / constants.K**2
    return AdaptedModel(constants.gain, constants.time_constant, delay, (load,))


def adapt(
    movements: Sequence[Movement], constants: ActuatorConstants | None = None
) -> AdaptedModel:
    """Adapt the model to one exemplar by the simulation error of its movements.

    Minimises Σ(ω_M − ω̂_M)² over μ, T, d and the load ℓ₀, ℓ₁, ℓ₂, … by variable projection (Golub
    and Pereyra 1973): for given T and d the others enter linearly. Samples slower than 15 % of the
    flat speed are left out: dry friction at standstill rules there. One movement suffices; a fault
    that is local or periodic moves six slow parameters by little.

    The fit runs on the movements reduced to 100 Hz: the ripple of a pulse-width modulation above
    would fit as well with a delay that is wrong by whole periods of it.

    Raises NotIdentifiable when no movement has both ramps and a flat part of half a second.
    """
    start = constants or ActuatorConstants()
    usable = [movement.reduced(_FIT_RATE) for movement in movements if _excites(movement)]
    if not usable:
        raise NotIdentifiable(
            "no movement has ramps and a flat part of half a second; the model cannot be adapted"
            " to it"
        )
    terms = max(_load_terms(movement, start) for movement in usable)
    fits = [_Projection(movement, terms) for movement in usable]

    def errors(theta: Signal) -> Signal:
        return np.concatenate([fit.errors(theta[0], theta[1]) for fit in fits])

    solution = least_squares(
        errors,
        [start.time_constant, _FIRST_DELAY],
        bounds=([1e-3, 0.0], [2.0, 0.2]),
        x_scale=[0.01, 0.005],
        diff_step=1e-3,
        xtol=1e-5,
        ftol=1e-6,
        max_nfev=30,
    )
    T, d = (float(value) for value in solution.x)
    linear = np.mean([fit.linear(T, d) for fit in fits], axis=0)
    std = _standard_deviations(solution, fits, T, d)
    return AdaptedModel(
        float(linear[0]), T, d, tuple(float(-value) for value in linear[1 : 1 + terms]), std
    )


def _excites(movement: Movement) -> bool:
    if np.max(movement.speed) <= 0 or np.max(movement.voltage) <= 0:
        return False
    flat, _ = flat_part(movement)
    ramps = flat.start + movement.n - flat.stop
    return (
        flat.stop - flat.start
    ) * movement.sample_time > 0.5 and ramps * movement.sample_time > 0.2


class _Projection:
    """Simulation error of one movement for given T and d, the linear parameters projected out."""

    def __init__(self, movement: Movement, load_terms: int) -> None:
        self.movement = movement
        moving = np.flatnonzero(movement.speed > _STANDSTILL * np.median(movement.speed))
        self.run = slice(int(moving[0]), int(moving[-1]) + 1)
        self.loads = _load_regressors(movement, load_terms)

    def regressors(self, T: float, d: float) -> Signal:
        Ts = self.movement.sample_time
        inputs = np.column_stack([delayed(self.movement.voltage, d, Ts), self.loads])[self.run]
        numerator, denominator = _first_order_hold(T, Ts)
        forced = lfilter(numerator, denominator, inputs, axis=0, zi=-numerator[0] * inputs[:1])[0]
        free = (-denominator[1]) ** np.arange(inputs.shape[0])
        return np.column_stack([forced, free])

    def linear(self, T: float, d: float) -> Signal:
        return np.asarray(
            np.linalg.lstsq(self.regressors(T, d), self.movement.speed[self.run], rcond=None)[0]
        )

    def errors(self, T: float, d: float) -> Signal:
        Phi = self.regressors(T, d)
        y = self.movement.speed[self.run]
        return np.asarray(y - Phi @ np.linalg.solve(Phi.T @ Phi, Phi.T @ y))


def _load_terms(movement: Movement, constants: ActuatorConstants) -> int:
    turns = float(movement.motor_angle[-1]) / (2.0 * np.pi * constants.gear_teeth)
    return max(_LOAD_SHAPE, 1 + round(turns / _TURNS_A_TERM))


def _load_regressors(movement: Movement, terms: int) -> Signal:
    """Shape (n, terms): 1, x, x² and then cosines, which unlike higher powers of x are nearly
    orthogonal.
    """
    angle = movement.motor_angle
    x = angle / angle[-1]
    powers = [x**power for power in range(min(terms, _LOAD_SHAPE))]
    return np.column_stack([*powers, *(np.cos(k * np.pi * x) for k in range(_LOAD_SHAPE, terms))])


def _standard_deviations(
    solution: object, fits: list[_Projection], T: float, d: float
) -> dict[str, float]:
    jacobian = np.asarray(getattr(solution, "jac"))  # noqa: B009  SciPy's result has no type
    errors = np.asarray(getattr(solution, "fun"))  # noqa: B009
    variance = float(errors @ errors) / max(1, errors.shape[0] - 8)
    nonlinear = np.sqrt(variance * np.diag(np.linalg.pinv(jacobian.T @ jacobian)))
    Phi = fits[0].regressors(T, d)
    gain = np.sqrt(variance * np.linalg.pinv(Phi.T @ Phi)[0, 0])
    return {"gain": float(gain), "time_constant": float(nonlinear[0]), "delay": float(nonlinear[1])}
