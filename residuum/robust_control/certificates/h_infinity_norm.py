"""The H∞ norm of a discrete-time system from the eigenvalues of a symplectic pencil, not from a grid."""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigvals

from residuum.array_types import FloatArray
from residuum.identification.blas_threads import LARGEST_FOR_ONE_THREAD, one_thread_if_small
from residuum.identification.errors import BadInput
from residuum.identification.linear_models.state_space import StateSpace

_ITERATIONS = 60
_NEAR_CIRCLE = 1e-4


@one_thread_if_small(LARGEST_FOR_ONE_THREAD)
def h_infinity_norm(system: StateSpace, *, tolerance: float = 1e-8) -> tuple[float, float]:
    r"""(upper bound of ‖H‖∞, normalised frequency θ = ω Ts [rad] of the peak).

    γ is a singular value of H at e^{jθ} exactly when e^{jθ} is an eigenvalue of the symplectic pencil

    .. math::
        \begin{bmatrix} \bar A & 0 \\ -C^T(C + D R^{-1} D^T C) & I \end{bmatrix} - \lambda
        \begin{bmatrix} I & -B R^{-1} B^T \\ 0 & \bar A^T \end{bmatrix}, \qquad
        \bar A = A + B R^{-1} D^T C, \quad R = \gamma^2 I - D^T D

    so a level without eigenvalues on the unit circle lies above the norm. Levels are raised to the largest gain between
    neighbouring crossings, which converges quadratically.

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
    Eigenvalues within 1e-4 of the circle count as possible crossings and are examined by the gain there, so rounding
    adds candidates and loses none unless it moves an eigenvalue by more than that.

    References
    ----------
    N. A. Bruinsma, M. Steinbuch, *A fast algorithm to compute the H∞-norm of a transfer function matrix*, Systems &
    Control Letters 14 (1990) 287–293; the pencil for discrete time: B. Hinrichsen, N. K. Son, *Stability radii of linear
    discrete-time systems and symplectic pencils*, Int. J. Robust Nonlinear Control 1 (1991) 79–97.

    Examples
    --------
    >>> lag = StateSpace(np.array([[0.5]]), np.eye(1), np.eye(1), np.zeros((1, 1)), sample_time=1.0)
    >>> round(h_infinity_norm(lag)[0], 6)
    2.0
    """
    poles = np.linalg.eigvals(system.A)
    if np.any(np.abs(poles) >= 1.0):
        raise BadInput(f"H-infinity norm: the system is not stable, its largest pole has modulus {np.abs(poles).max():.9g}")
    angles = np.unique(np.abs(np.concatenate([np.angle(poles), np.geomspace(1e-6, np.pi, 60), [0.0]])))
    lower, peak = _largest(system, angles)
    if lower == 0.0:
        return 0.0, 0.0
    for _ in range(_ITERATIONS):
        level = lower * (1.0 + 2.0 * tolerance)
        crossings = _crossings(system, level)
        ends = np.unique(np.concatenate([[0.0, np.pi], crossings]))
        found, at = _largest(system, np.concatenate([ends, 0.5 * (ends[1:] + ends[:-1])]))
        if found <= level:
            return level, peak
        lower, peak = found, at
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
    found = eigvals(right, left)
    found = found[np.isfinite(found) & (np.abs(np.abs(found) - 1.0) < _NEAR_CIRCLE)]
    return np.unique(np.abs(np.angle(found)))
