"""Post-filters of the source's other residual generators: observer, Kalman filter, parity space, H∞ estimate (1.56).

Every linear residual generator of a plant y = G u is r = Q (M y − N u), so each of them is a Q. For a stable model M = 1 and
N = G, and Q is the generator's own path from y to r; that its path from u is then −Q G makes it blind to the input.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from residuum.diagnosis.residuals.generators.approximate_fault_detection import FaultKind, PostFilter, noise_path
from residuum.diagnosis.residuals.generators.kalman_residual import kalman_residual
from residuum.diagnosis.residuals.generators.parity_space import parity_space
from residuum.diagnosis.residuals.generators.unknown_input_observer import unknown_input_observer
from residuum.diagnosis.systems.balanced_truncation import balanced_truncation
from residuum.diagnosis.systems.coprime import LeftCoprimeFactors
from residuum.diagnosis.systems.system_norms import h_infinity_norm
from residuum.identification.errors import BadInput, BadModel
from residuum.identification.linear_models.state_space import StateSpace
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.nearest_names import known_names

_GRID = 1000
_NEGLIGIBLE = 1e-4  # of the plant's gain


@dataclass(frozen=True, eq=False)
class Given:
    """What a classical design starts from: plant, its factors, W_T, variances of model error at the input and of the noise."""

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
        """The plant without states that carry nothing, and the model error as white noise on its input: mean |W_T|² var u."""
        if not plant.is_stable:
            raise BadModel("classical residual methods: need a stable model; the method robust takes others")
        omega = np.linspace(0.0, np.pi / plant.sample_time, _GRID)
        error = 0.0 if W_T is None else float(np.mean(np.abs(W_T.frequency_response(omega)) ** 2))
        small = balanced_truncation(plant, _NEGLIGIBLE * h_infinity_norm(plant)[0]).system
        return cls(small, factors, W_T, max(error * input_variance, 1e-12), max(noise_variance, 1e-12), fault)


def classical_filter(method: str, given: Given) -> PostFilter:
    """The post-filter of a method of `CLASSICAL_METHODS`, with its gains verified like those of the robust one.

    Raises
    ------
    BadInput
        No such method.
    BadModel
        A fault that the method cannot be made for.
    """
    if method not in CLASSICAL_METHODS:
        raise BadInput(
            f"residual method {method!r}: there is none of this name; {known_names(method, ['robust', *CLASSICAL_METHODS])}"
        )
    Q = CLASSICAL_METHODS[method](given)
    gamma = h_infinity_norm(Q @ noise_path(given.factors, given.W_T))[0]
    beta, at = h_infinity_norm(Q @ (given.factors.M if given.fault == "sensor" else given.factors.N))
    return PostFilter(Q, gamma, gamma, beta, at, Q.order, 0.0)


def _kalman(given: Given) -> StateSpace:
    """Innovation of the stationary Kalman predictor, scaled to unit variance."""
    return _from_output(kalman_residual(given.plant, given.process_noise, given.measurement_noise).predictor)


def _observer(given: Given) -> StateSpace:
    """Full-order observer without a model of the noise: the unknown-input observer with no unknown input."""
    noise = given.measurement_noise / max(given.process_noise, 1e-12)
    return _from_output(unknown_input_observer(given.plant, np.zeros((given.plant.order, 0)), noise).filter)


def _parity(given: Given) -> StateSpace:
    """Parity vector over twice as many samples as the plant has states, (1.60)–(1.70)."""
    weights = parity_space(given.plant, 2 * given.plant.order, given.process_noise, given.measurement_noise).on_y[::-1]
    delay = np.r_[1.0, np.zeros(len(weights) - 1)]
    return StateSpace.from_transfer_function(TransferFunction(weights, delay, given.plant.sample_time))


def _estimate(given: Given) -> StateSpace:
    """min ‖[Q M G_f − 1, Q [N W_T, M]]‖∞, (1.56): the residual that is nearest to the fault itself.

    For a sensor fault of a stable plant the integrand |Q − 1|² + |Q|² (1 + |N W_T|²) is least, at the frequency where |N W_T| is
    largest, for Q = 1/(2 + |N W_T|²); the same constant is smaller at all others, so it is the optimum.
    """
    if given.fault != "sensor":
        raise BadModel(
            "residual method h-infinity: is made for sensor faults; where the plant's gain vanishes an actuator fault cannot be "
            "estimated, and the optimum of (1.56) is Q = 0"
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
    return StateSpace(generator.A, generator.B[:, :1], generator.C, generator.D[:, :1], generator.sample_time)
