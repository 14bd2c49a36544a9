"""Post-filters of the source's other residual generators: observer, Kalman filter, parity space, H∞
estimate (1.56).

Every linear residual generator of a plant y = G u is r = Q (M y − N u), so each of them is a Q. For
a stable model M = 1 and N = G, and Q is the generator's own path from y to r; that its path from u
is then −Q G makes it blind to the input.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import linalg, signal

from residuum.array_types import FloatArray
from residuum.diagnosis.residuals.generators.approximate_fault_detection import (
    FaultKind,
    PostFilter,
    noise_path,
)
from residuum.diagnosis.systems import LeftCoprimeFactors, balanced_truncation, h_infinity_norm
from residuum.identification.errors import BadInput, BadModel
from residuum.identification.linear_models.state_space import StateSpace
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.nearest_names import known_names

# Kalman innovation: the residual of a stationary Kalman predictor, scaled to unit variance.


@dataclass(frozen=True, eq=False)
class KalmanResidual:
    """S^(−½) (y − C x̂ − D u) with x̂⁺ = A x̂ + B u + K (y − C x̂ − D u), one output; white of
    variance 1 while healthy.
    """

    predictor: StateSpace  # inputs [y; u]

    def residual(self, u: npt.ArrayLike, y: npt.ArrayLike) -> FloatArray:
        """Innovation, shape (n,), from rest."""
        return self.predictor.simulate(np.column_stack([y, u]))[0][:, 0]


def kalman_residual(
    system: StateSpace, process_noise: float, measurement_noise: float
) -> KalmanResidual:
    """Stationary Kalman predictor for white noise on the input and on the output.

    Parameters
    ----------
    system : StateSpace
        One input, one output.
    process_noise, measurement_noise : float
        Variances [input unit²], [output unit²]; the process noise stands for the model error.

    Raises
    ------
    BadModel
        No stabilising solution of the Riccati equation (an undetectable mode).
    """
    A, B, C, D = system.A, system.B, system.C, system.D
    R = np.atleast_2d(measurement_noise)
    try:
        X = linalg.solve_discrete_are(A.T, C.T, process_noise * B @ B.T + 1e-12 * np.eye(len(A)), R)
    except (linalg.LinAlgError, ValueError):
        raise BadModel(
            "kalman_residual: a mode of the system cannot be seen at the output"
        ) from None
    S = C @ X @ C.T + R
    K = A @ X @ C.T @ np.linalg.inv(S)
    scale = 1.0 / np.sqrt(S)
    return KalmanResidual(
        StateSpace(
            A - K @ C,
            np.hstack([K, B - K @ D]),
            -scale @ C,
            np.hstack([scale, -scale @ D]),
            system.sample_time,
        )
    )


# Parity space residual: a combination of the last b + 1 outputs and inputs that the unknown state
# cannot move.


@dataclass(frozen=True, eq=False)
class ParityResidual:
    """r(t) = v (y_b(t) − H_u u_b(t)), oldest sample first; the weights on the last b + 1 samples of
    y and of u.
    """

    on_y: FloatArray
    on_u: FloatArray

    def residual(self, u: npt.ArrayLike, y: npt.ArrayLike) -> FloatArray:
        """Residual, shape (n,); NaN in the first b samples."""
        r = signal.lfilter(self.on_y[::-1], [1.0], y) - signal.lfilter(self.on_u[::-1], [1.0], u)
        r[: len(self.on_y) - 1] = np.nan
        return np.asarray(r)


def parity_space(
    system: StateSpace, b: int, process_noise: float = 0.0, measurement_noise: float = 1.0
) -> ParityResidual:
    """The parity vector that is most sensitive to a sensor offset for its noise; (1.60)–(1.70) of
    the source.

    Of all v with v H_o = 0 it maximises (v 1)²/(v R v), R the covariance of white noise on the
    input (variance `process_noise`) and on the output (`measurement_noise`) over the window. Scaled
    to unit variance.

    Parameters
    ----------
    system : StateSpace
        One input, one output.
    b : int
        Window b ≥ order of the system.

    Raises
    ------
    BadModel
        b is smaller than the order, or there is more than one input or output.
    """
    if system.D.shape != (1, 1):
        raise BadModel("parity_space: needs one input and one output")
    if b < system.order:
        raise BadModel(
            f"parity_space, b: is {b}; must be at least the order of the system, {system.order}"
        )
    observability = np.vstack(
        [system.C @ np.linalg.matrix_power(system.A, k) for k in range(b + 1)]
    )
    response = system.impulse_response(b + 1)[:, 0, 0]
    H_u = linalg.toeplitz(response, np.zeros(b + 1))
    # rows v with v H_o = 0, and of their span the one of the largest (v 1)²/(v R v)
    null = linalg.null_space(observability.T).T
    covariance = null @ (process_noise * H_u @ H_u.T + measurement_noise * np.eye(b + 1)) @ null.T
    direction = np.linalg.solve(covariance, null @ np.ones(b + 1))
    v = direction @ null / np.sqrt(direction @ covariance @ direction)
    return ParityResidual(v, v @ H_u)


# Unknown input observer: a residual that an unmeasured input d along a known direction E cannot
# move.


@dataclass(frozen=True, eq=False)
class UnknownInputObserver:
    """z⁺ = F z + T B u + K y, x̂ = z + H y, r = y − D u − C x̂."""

    filter: StateSpace  # inputs [y; u]

    def residual(self, u: npt.ArrayLike, y: npt.ArrayLike) -> FloatArray:
        """Residual, shape (n, p), from rest; u of shape (n,) or (n, q), y of shape (n,) or (n,
        p).
        """
        return self.filter.simulate(np.column_stack([y, u]))[0]


def unknown_input_observer(
    system: StateSpace, E: npt.ArrayLike, measurement_noise: float = 1.0
) -> UnknownInputObserver:
    """Observer of x⁺ = A x + B u + E d, y = C x, whose residual does not depend on d (Chen and
    Patton, 1999, ch. 3).

    H = E (C E)⁺ and T = 1 − H C remove d from the estimation error; F = T A − K₁ C is made stable
    by a Kalman gain. It exists when rank C E = rank E and the pair (C, T A) is detectable, with
    more outputs than unknown inputs. Without columns in E it is the plain full-order observer.

    Raises
    ------
    BadModel
        D ≠ 0, or the conditions of existence fail; the message says which.
    """
    A, B, C = system.A, system.B, system.C
    E = np.asarray(E, dtype=float).reshape(system.order, -1)
    if np.any(system.D):
        raise BadModel("unknown_input_observer: needs a system without direct feedthrough, D = 0")
    if E.shape[1] and np.linalg.matrix_rank(C @ E) < np.linalg.matrix_rank(E):
        raise BadModel(
            "unknown_input_observer: rank C E < rank E; the unknown input does not reach the"
            " outputs in one step"
        )
    if E.shape[1] >= C.shape[0]:
        raise BadModel(
            f"unknown_input_observer: {E.shape[1]} unknown inputs use up all {C.shape[0]} outputs;"
            " no residual is left"
        )
    H = E @ np.linalg.pinv(C @ E) if E.shape[1] else np.zeros((system.order, C.shape[0]))
    T = np.eye(system.order) - H @ C
    A1 = T @ A
    try:
        X = linalg.solve_discrete_are(
            A1.T, C.T, np.eye(system.order), measurement_noise * np.eye(C.shape[0])
        )
    except (linalg.LinAlgError, ValueError):
        raise BadModel(
            "unknown_input_observer: (C, T A) is not detectable; a zero of the path from d to y is"
            " unstable"
        ) from None
    K1 = A1 @ X @ C.T @ np.linalg.inv(C @ X @ C.T + measurement_noise * np.eye(C.shape[0]))
    F = A1 - K1 @ C
    K = K1 + F @ H
    p = C.shape[0]
    return UnknownInputObserver(
        StateSpace(
            F,
            np.hstack([K, T @ B]),
            -C,
            np.hstack([np.eye(p) - C @ H, np.zeros((p, B.shape[1]))]),
            system.sample_time,
        )
    )


_GRID = 1000  # frequencies from 0 to Nyquist
_NEGLIGIBLE = 1e-4  # of the plant's gain, below which its states are dropped


@dataclass(frozen=True, eq=False)
class Given:
    """What a classical design starts from: plant, its factors, W_T, variances of model error at the
    input and of the noise.
    """

    plant: StateSpace
    factors: LeftCoprimeFactors
    W_T: TransferFunction | None
    process_noise: float
    measurement_noise: float
    fault: FaultKind

    @classmethod
    def of(
        cls,
        plant: StateSpace,
        factors: LeftCoprimeFactors,
        W_T: TransferFunction | None,
        input_variance: float,
        noise_variance: float,
        fault: FaultKind,
    ) -> Given:
        """The plant without states that carry nothing, and the model error as white noise on its
        input: mean |W_T|² var u.
        """
        if not plant.is_stable:
            raise BadModel(
                "classical residual methods: need a stable model; the method robust takes others"
            )
        omega = np.linspace(0.0, np.pi / plant.sample_time, _GRID)
        error = 0.0 if W_T is None else float(np.mean(np.abs(W_T.frequency_response(omega)) ** 2))
        small = balanced_truncation(plant, _NEGLIGIBLE * h_infinity_norm(plant)[0]).system
        return cls(
            small,
            factors,
            W_T,
            max(error * input_variance, 1e-12),
            max(noise_variance, 1e-12),
            fault,
        )


def classical_filter(method: str, given: Given) -> PostFilter:
    """The post-filter of a method of `CLASSICAL_METHODS`, with its gains verified like those of the
    robust one.

    Raises
    ------
    BadInput
        No such method.
    BadModel
        A fault that the method cannot be made for.
    """
    if method not in CLASSICAL_METHODS:
        raise BadInput(
            f"residual method {method!r}: there is none of this name;"
            f" {known_names(method, ['robust', *CLASSICAL_METHODS])}"
        )
    Q = CLASSICAL_METHODS[method](given)
    gamma = h_infinity_norm(Q @ noise_path(given.factors, given.W_T))[0]
    beta, at = h_infinity_norm(
        Q @ (given.factors.M if given.fault == "sensor" else given.factors.N)
    )
    return PostFilter(Q, gamma, gamma, beta, at, Q.order, 0.0)


def _kalman(given: Given) -> StateSpace:
    """Innovation of the stationary Kalman predictor, scaled to unit variance."""
    return _from_output(
        kalman_residual(given.plant, given.process_noise, given.measurement_noise).predictor
    )


def _observer(given: Given) -> StateSpace:
    """Full-order observer without a model of the noise: the unknown-input observer with no unknown
    input.
    """
    noise = given.measurement_noise / max(given.process_noise, 1e-12)
    return _from_output(
        unknown_input_observer(given.plant, np.zeros((given.plant.order, 0)), noise).filter
    )


def _parity(given: Given) -> StateSpace:
    """Parity vector over twice as many samples as the plant has states, (1.60)–(1.70)."""
    weights = parity_space(
        given.plant, 2 * given.plant.order, given.process_noise, given.measurement_noise
    ).on_y[::-1]
    delay = np.r_[1.0, np.zeros(len(weights) - 1)]
    return StateSpace.from_transfer_function(
        TransferFunction(weights, delay, given.plant.sample_time)
    )


def _estimate(given: Given) -> StateSpace:
    """min ‖[Q M G_f − 1, Q [N W_T, M]]‖∞, (1.56): the residual that is nearest to the fault itself.

    For a sensor fault of a stable plant the integrand |Q − 1|² + |Q|² (1 + |N W_T|²) is least, at
    the frequency where |N W_T| is largest, for Q = 1/(2 + |N W_T|²); the same constant is smaller
    at all others, so it is the optimum.
    """
    if given.fault != "sensor":
        raise BadModel(
            "residual method h-infinity: is made for sensor faults; where the plant's gain vanishes"
            " an actuator fault cannot be estimated, and the optimum of (1.56) is Q = 0"
        )
    omega = np.linspace(0.0, np.pi / given.plant.sample_time, _GRID)
    error = np.zeros(1)
    if given.W_T is not None:
        N = given.factors.N.frequency_response(omega)[:, 0, 0]
        error = np.abs(N * given.W_T.frequency_response(omega))
    return StateSpace.gain([[1.0 / (2.0 + float(error.max()) ** 2)]], given.plant.sample_time)


CLASSICAL_METHODS: dict[str, Callable[[Given], StateSpace]] = {
    "observer": _observer,
    "kalman": _kalman,
    "parity": _parity,
    "h-infinity": _estimate,
}
"""Name → what makes Q."""


def _from_output(generator: StateSpace) -> StateSpace:
    """The path from y of a generator with inputs [y; u]."""
    return StateSpace(
        generator.A, generator.B[:, :1], generator.C, generator.D[:, :1], generator.sample_time
    )
