"""The gate actuator as a motor with a rigid transmission: constants, simulation, and adaptation to one exemplar."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.ndimage import shift
from scipy.optimize import least_squares
from scipy.signal import lfilter

from residuum.diagnosis.gate.movements import Movement, flat_part
from residuum.identification.errors import BadInput, NotIdentifiable

Signal = npt.NDArray[np.float64]
_STANDSTILL = 0.15  # of the flat speed: below it dry friction at standstill rules, which the model has not
_FIT_RATE = 100.0  # Hz
_FIRST_DELAY = 5e-3  # s, where the search starts
_LOAD_SHAPE = 3  # constant, slope and curvature of the load along the gate, and at least that many terms
_TURNS_A_TERM = 8  # of the shaft; 1.4 m of the source's gate, whose way is two of them


@dataclass(frozen=True)
class ActuatorConstants:
    """Constants of the data sheet (Valceschini, section 7.3); tooth numbers set the fault frequencies.

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
        τ̄ = v_M/ω_M [m/rad]; None takes r / gear_teeth. (The source prints r/47 beside 44 teeth; only 44 gives its
        fault frequency of 1.55 Hz at 4100 rpm.)

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
        return self.gear_radius / self.gear_teeth if self.transmission is None else self.transmission

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
        """Turns a second of the shaft that carries the nylon gear and the pinion [Hz] at ω_M [rad/s]."""
        return motor_speed / (2.0 * np.pi * self.gear_teeth)


def first_order_response(u: Signal, T: float, sample_time: float, initial: float = 0.0) -> Signal:
    """Response of 1/(T s + 1) to u, straight between its samples, from y₀ = `initial`, shape (n,).

    Exact for the voltage's ramps; an input held between samples would shift the response by half a sample.
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

    A cubic spline gives fractions of a sample: linear interpolation would smooth the pulse-width ripple between samples
    only, which pulls an estimated delay onto whole samples.
    """
    return np.asarray(shift(u, delay / sample_time, order=3, mode="nearest"))


@dataclass(frozen=True)
class AdaptedModel:
    r"""The source's model with the constants of one exemplar.

    .. math:: T \dot\omega + \omega = \mu V(t-d) - \ell(x)

    which is (7.2) and (7.4): with L = D = 0 the load torque τ_L acts as ℓ = τ_L R/K². A viscous friction D only changes
    μ and T; the load may vary slowly along the gate, ℓ(x) = ℓ₀ + ℓ₁x + ℓ₂x² over the travel x from 0 to 1. A gate longer
    than 20 turns of the shaft has a term more for every eight, ℓ_k cos kπx from k = 3: so its load is followed as finely
    in metres as that of a short one.

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
        Standard deviation of gain, time_constant and delay from the fit (white residual assumed: too small when it is
        coloured).
    """

    gain: float
    time_constant: float
    delay: float
    load: tuple[float, ...] = (0.0,)
    std: dict[str, float] = field(default_factory=dict, compare=False)

    def simulate(self, movement: Movement) -> Signal:
        """Motor speed ω̂_M [rad/s] of the model under the movement's voltage from its measured first speed, shape (n,)."""
        V = delayed(movement.voltage, self.delay, movement.sample_time)
        load = _load_regressors(movement, len(self.load)) @ np.asarray(self.load)
        drive = np.maximum(self.gain * V - load, 0.0)  # dry friction stops the gate, it never drives it back
        return first_order_response(drive, self.time_constant, movement.sample_time, movement.speed[0])

    def residual(self, movement: Movement) -> Signal:
        """r = ω_M − ω̂_M [rad/s], shape (n,): the output error (7.5) before it is multiplied by τ̄."""
        return movement.speed - self.simulate(movement)


def from_data_sheet(constants: ActuatorConstants, delay: float = 0.0, friction_force: float | None = None) -> AdaptedModel:
    """The model whose constants are all taken from the data sheet; friction force F_L [N], None takes m·g·3·10⁻⁴."""
    force = constants.gate_mass * 9.81 * 3e-4 if friction_force is None else friction_force
    load = force * constants.tau * constants.R / constants.K**2
    return AdaptedModel(constants.gain, constants.time_constant, delay, (load,))


def adapt(movements: Sequence[Movement], constants: ActuatorConstants | None = None) -> AdaptedModel:
    """Adapt the model to one exemplar by the simulation error of its movements.

    Minimises Σ(ω_M − ω̂_M)² over μ, T, d and the load ℓ₀, ℓ₁, ℓ₂, … by variable projection (Golub and Pereyra 1973):
    for given T and d the others enter linearly. Samples slower than 15 % of the flat speed are left out: dry friction
    at standstill rules there. One movement suffices; a fault that is local or periodic moves six slow parameters by little.

    The fit runs on the movements reduced to 100 Hz: the ripple of a pulse-width modulation above would fit as well with a
    delay that is wrong by whole periods of it.

    Raises NotIdentifiable when no movement has both ramps and a flat part of half a second.
    """
    start = constants or ActuatorConstants()
    usable = [movement.reduced(_FIT_RATE) for movement in movements if _excites(movement)]
    if not usable:
        raise NotIdentifiable("no movement has ramps and a flat part of half a second; the model cannot be adapted to it")
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
    return AdaptedModel(float(linear[0]), T, d, tuple(float(-value) for value in linear[1 : 1 + terms]), std)


def _excites(movement: Movement) -> bool:
    if np.max(movement.speed) <= 0 or np.max(movement.voltage) <= 0:
        return False
    flat, _ = flat_part(movement)
    ramps = flat.start + movement.n - flat.stop
    return (flat.stop - flat.start) * movement.sample_time > 0.5 and ramps * movement.sample_time > 0.2


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
        return np.asarray(np.linalg.lstsq(self.regressors(T, d), self.movement.speed[self.run], rcond=None)[0])

    def errors(self, T: float, d: float) -> Signal:
        Phi = self.regressors(T, d)
        y = self.movement.speed[self.run]
        return np.asarray(y - Phi @ np.linalg.solve(Phi.T @ Phi, Phi.T @ y))


def _load_terms(movement: Movement, constants: ActuatorConstants) -> int:
    turns = float(movement.motor_angle[-1]) / (2.0 * np.pi * constants.gear_teeth)
    return max(_LOAD_SHAPE, 1 + round(turns / _TURNS_A_TERM))


def _load_regressors(movement: Movement, terms: int) -> Signal:
    """Shape (n, terms): 1, x, x² and then cosines, which unlike higher powers of x are nearly orthogonal."""
    angle = movement.motor_angle
    x = angle / angle[-1]
    powers = [x**power for power in range(min(terms, _LOAD_SHAPE))]
    return np.column_stack([*powers, *(np.cos(k * np.pi * x) for k in range(_LOAD_SHAPE, terms))])


def _standard_deviations(solution: object, fits: list[_Projection], T: float, d: float) -> dict[str, float]:
    jacobian = np.asarray(getattr(solution, "jac"))  # noqa: B009  SciPy's result has no type
    errors = np.asarray(getattr(solution, "fun"))  # noqa: B009
    variance = float(errors @ errors) / max(1, errors.shape[0] - 8)
    nonlinear = np.sqrt(variance * np.diag(np.linalg.pinv(jacobian.T @ jacobian)))
    Phi = fits[0].regressors(T, d)
    gain = np.sqrt(variance * np.linalg.pinv(Phi.T @ Phi)[0, 0])
    return {"gain": float(gain), "time_constant": float(nonlinear[0]), "delay": float(nonlinear[1])}
