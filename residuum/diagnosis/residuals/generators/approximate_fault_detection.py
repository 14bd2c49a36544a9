"""Synthesis of the post-filter Q: the approximate (AFDP) and the exact (EFDP) fault detection
problem.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from residuum.array_types import FloatArray
from residuum.diagnosis.systems import (
    LeftCoprimeFactors,
    ReducedSystem,
    balanced_truncation,
    co_outer_factor,
    h_infinity_norm,
)
from residuum.identification.errors import BadModel
from residuum.identification.linear_models.state_space import StateSpace
from residuum.identification.linear_models.transfer_function import TransferFunction

FaultKind = Literal["sensor", "actuator"]
_GRID = 1000
_SAME_RATE = 1e-9  # sample times read from a record differ by rounding
# of N, below which its states are dropped before the synthesis; what they carry is charged to γ
_NEGLIGIBLE = 1e-10


@dataclass(frozen=True, eq=False)
class PostFilter:
    """A verified post-filter Q.

    Parameters
    ----------
    Q : StateSpace
        The filter, of reduced order.
    gamma : float
        ‖Q [N W_T, M]‖_∞, computed anew from the filter that is returned: at most the γ asked for.
    gamma_grid : float
        The same on a grid of 1000 frequencies, on the exact path; never above `gamma`.
    beta : float
        ‖Q M G_f‖_∞; β/γ is the decoupling index of the source.
    beta_at : float
        Frequency [rad/s] where β is reached.
    full_order, reduction_error : int, float
        Order of the exact optimum, and the bound on ‖Q − Q_full‖_∞ that reduction costs (before Q
        is rescaled to γ).
    """

    Q: StateSpace
    gamma: float
    gamma_grid: float
    beta: float
    beta_at: float
    full_order: int
    reduction_error: float

    @property
    def decoupling(self) -> float:
        """β/γ: fault gain over the gain of everything else; infinite for the exact problem."""
        return self.beta / self.gamma if self.gamma > 0 else float("inf")


def approximate_fault_detection(
    factors: LeftCoprimeFactors,
    W_T: TransferFunction | None,
    *,
    fault: FaultKind = "sensor",
    gamma: float = 0.1,
    input_level: float = 1.0,
    noise_level: float = 1.0,
    tolerance: float = 0.03,
) -> PostFilter:
    """Post-filter Q that makes the residual most sensitive to the fault within a budget for all
    else.

    Algorithm 5 and (4.6)–(4.8) of the source: maximise β = ‖Q M G_f‖_∞ subject to ‖Q M [G₀ W_T,
    1]‖_∞ ≤ γ, with G_f = 1 for a sensor fault and G₀ for an actuator fault. The optimum is Q = γ
    G_o⁻¹, G_o the co-outer factor of [N W_T, M] (Varga, Solving Fault Diagnosis Problems, 2017, ch.
    5): it spends the whole budget at every frequency, so it is also the filter of largest fault
    gain at each single frequency. It has the order of [N W_T, M]; balanced truncation takes that
    down, and the result is rescaled so that the budget holds exactly.

    Parameters
    ----------
    factors : LeftCoprimeFactors
        Of the nominal model, one output.
    W_T : TransferFunction or None
        Stable proper multiplicative uncertainty weight (Algorithm 1), discrete-time; None = no
        uncertainty.
    fault : "sensor" or "actuator"
    gamma : float
        Budget γ > 0.
    input_level, noise_level : float
        Sizes of u and e that count as one unit each; 1 and 1 is the printed form (4.6), signal
        levels make the budget mean the same in both channels.
    tolerance : float
        Error of the order reduction, relative to ‖Q‖_∞.

    Raises
    ------
    BadModel
        W_T is unstable, improper, continuous-time or of another sample time; γ or a level not
        positive; more than one output.
    """
    _check(factors, W_T, gamma, input_level, noise_level)
    exact = noise_path(factors, W_T, input_level, noise_level)
    # A hundred taps leave states that carry nothing; without them the Riccati equation is small and
    # well conditioned.
    size = float(np.abs(factors.N.impulse_response(factors.N.order + 2)).sum())
    N = balanced_truncation(factors.N, _NEGLIGIBLE * size)
    small = LeftCoprimeFactors(factors.M, N.system, factors.observer, factors.observer_gain)
    noise = noise_path(small, W_T, input_level, noise_level)
    full = co_outer_factor(noise).inverse() * gamma
    reduced = balanced_truncation(full, tolerance * h_infinity_norm(full)[0])
    left_out = (
        0.0
        if W_T is None
        else N.error_bound
        * input_level
        * h_infinity_norm(StateSpace.from_transfer_function(W_T))[0]
    )
    fault_path = small.M if fault == "sensor" else small.N
    return _verified(reduced, noise, exact, left_out, fault_path, gamma)


def noise_path(
    factors: LeftCoprimeFactors,
    W_T: TransferFunction | None,
    input_level: float = 1.0,
    noise_level: float = 1.0,
) -> StateSpace:
    """[N W_T, M] scaled by the levels: from the fictitious noise [u; e] of (4.5) to the primary
    residual.
    """
    measurement = factors.M * noise_level
    if W_T is None:
        return measurement
    return (factors.N @ StateSpace.from_transfer_function(W_T) * input_level).beside(measurement)


def _check(
    factors: LeftCoprimeFactors, W_T: TransferFunction | None, gamma: float, *levels: float
) -> None:
    if factors.M.D.shape != (1, 1) or factors.N.D.shape != (1, 1):
        raise BadModel("approximate_fault_detection: needs a model of one input and one output")
    if not gamma > 0 or not np.isfinite(gamma):
        raise BadModel(f"approximate_fault_detection, gamma: is {gamma!r}; must be positive")
    if not all(np.isfinite(level) and level > 0 for level in levels):
        raise BadModel(f"approximate_fault_detection, levels: are {levels}; must be positive")
    if W_T is not None:
        _check_weight(W_T, factors.M.sample_time)


def _check_weight(W_T: TransferFunction, sample_time: float) -> None:
    if W_T.sample_time is None or abs(W_T.sample_time / sample_time - 1.0) > _SAME_RATE:
        raise BadModel(
            f"approximate_fault_detection, W_T: has sample time {W_T.sample_time} s, "
            f"the model {sample_time} s; must be equal"
        )
    if not W_T.is_proper or not W_T.is_stable:
        raise BadModel("approximate_fault_detection, W_T: must be stable and proper")


def _verified(
    reduced: ReducedSystem,
    noise: StateSpace,
    exact: StateSpace,
    left_out: float,
    fault_path: StateSpace,
    gamma: float,
) -> PostFilter:
    """Rescale Q so that the budget holds exactly, and compute what is promised from the filter
    itself.

    `left_out` bounds the part of the `exact` noise path that `noise` lacks; it is charged to the
    budget.
    """
    Q = reduced.system
    if not Q.is_stable:
        raise BadModel(
            "approximate_fault_detection: the reduced post-filter is unstable; ask for a smaller"
            " tolerance"
        )
    reached = h_infinity_norm(Q @ noise)[0] + left_out * h_infinity_norm(Q)[0]
    Q = Q * (gamma / reached)
    reached = h_infinity_norm(Q @ noise)[0] + left_out * h_infinity_norm(Q)[0]
    beta, at = h_infinity_norm(Q @ fault_path)
    return PostFilter(Q, reached, _grid_norm(Q, exact), beta, at, exact.order, reduced.error_bound)


def _grid_norm(Q: StateSpace, noise: StateSpace) -> float:
    omega: FloatArray = np.linspace(0.0, np.pi / Q.sample_time, _GRID)
    product = Q.frequency_response(omega) @ noise.frequency_response(omega)
    return float(np.linalg.norm(product, ord=2, axis=(1, 2)).max())
