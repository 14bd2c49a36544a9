"""Left coprime factorisation G = M⁻¹ N over the stable proper rational functions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from residuum.array_types import FloatArray
from residuum.identification.errors import BadModel
from residuum.identification.linear_models.state_space import StateSpace


@dataclass(frozen=True, eq=False)
class LeftCoprimeFactors:
    """Stable M, N with G = M⁻¹ N that share the observer x⁺ = (A − L C) x + (B − L D) u + L y.

    Parameters
    ----------
    M : StateSpace, p × p
        y → M y = y − C x.
    N : StateSpace, p × q
        u → N u.
    observer : StateSpace, p × (p + q)
        [M, −N]: its output for the input [y; u] is the primary residual M y − N u, (1.46) of the source.
    observer_gain : array, shape (n, p)
        L.
    """

    M: StateSpace
    N: StateSpace
    observer: StateSpace
    observer_gain: FloatArray


def left_coprime(system: StateSpace, *, normalised: bool = False) -> LeftCoprimeFactors:
    """Left coprime factors of a detectable proper system, stable or not; definition 1.8 of the source.

    A stable system keeps L = 0, hence M = 1 and N = G, unless `normalised` asks for M M~ + N N~ = 1. Otherwise L is the
    stationary Kalman gain for unit noise on input and output, which is what makes the factors normalised after scaling
    with (1 + D Dᵀ + C X Cᵀ)^(−1/2).

    Raises
    ------
    BadModel
        An unstable mode of the system is not seen at its output, so no stable observer exists.

    Examples
    --------
    >>> from residuum.identification.linear_models.transfer_function import TransferFunction
    >>> unstable = StateSpace.from_transfer_function(TransferFunction([1.0], [1.0, -2.0], sample_time=1.0))
    >>> factors = left_coprime(unstable)
    >>> factors.M.is_stable and factors.N.is_stable
    True
    """
    p = system.D.shape[0]
    if system.is_stable and not normalised:
        L = np.zeros((system.order, p))
        observer = StateSpace.gain(np.eye(p), system.sample_time).beside(system * -1.0)
        return LeftCoprimeFactors(StateSpace.gain(np.eye(p), system.sample_time), system, observer, L)
    L, scale = _kalman_gain(system)
    A, B = system.A - L @ system.C, system.B - L @ system.D
    C, D = scale @ system.C, scale @ system.D
    Ts = system.sample_time
    return LeftCoprimeFactors(
        M=StateSpace(A, L, -C, scale, Ts),
        N=StateSpace(A, B, C, D, Ts),
        observer=StateSpace(A, np.hstack([L, B]), -C, np.hstack([scale, -D]), Ts),
        observer_gain=L,
    )


def _kalman_gain(system: StateSpace) -> tuple[FloatArray, FloatArray]:
    """Stationary predictor gain L for unit white noise at input and output, and the normalising factor."""
    A, B, C, D = system.A, system.B, system.C, system.D
    measurement = np.eye(D.shape[0]) + D @ D.T
    try:
        X = linalg.solve_discrete_are(A.T, C.T, B @ B.T, measurement, s=B @ D.T)
    except (linalg.LinAlgError, ValueError):
        raise BadModel("left_coprime: an unstable or undamped mode cannot be seen at the output (not detectable)") from None
    innovation = measurement + C @ X @ C.T
    L = np.linalg.solve(innovation, (A @ X @ C.T + B @ D.T).T).T
    if np.any(np.abs(np.linalg.eigvals(A - L @ C)) >= 1.0):
        raise BadModel("left_coprime: an unstable or undamped mode cannot be seen at the output (not detectable)")
    eigenvalues, vectors = np.linalg.eigh(innovation)
    return L, (vectors / np.sqrt(eigenvalues)) @ vectors.T
