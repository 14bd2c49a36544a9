"""One step of a minimax problem: the quadratic programme in its epigraph form."""

# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

from residuum.array_types import FloatArray
from residuum.kept_loops import njit

_SMALLEST_PIVOT = 1e-12


def minimax_step(
    c: FloatArray, A: FloatArray, H: FloatArray, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    r"""(d, λ, t): :math:`\min_{d,t} t + \tfrac12 t^2 + \tfrac12 d^T H d` with :math:`c_i + a_i^T d \le t`, low ≤ d ≤ high.

    The problem is one of least distance from (0, −1) in the coordinates (Lᵀd, t), H = L Lᵀ, which non-negative least squares
    solves exactly in as many steps as constraints become active. The term ½t² makes it one; near the solution, where
    t → 0, it has no weight.

    Parameters
    ----------
    c, A : array, shapes (m,), (m, n)
        Values of the functions less their maximum, and their slopes.
    H : array, shape (n, n)
        Curvature, positive definite.
    low, high : array, shape (n,)
        Bounds, low ≤ 0 ≤ high.

    Returns
    -------
    d, λ, t : array (n,), array (m,), float
        The step, the multipliers of the functions (their sum is 1 + t), and the largest linear model at the step.

    References
    ----------
    C. L. Lawson, R. J. Hanson, *Solving Least Squares Problems*, chapter 23 (least distance programming).

    Examples
    --------
    >>> d, multipliers, t = minimax_step(
    ...     np.array([0.0, -1.0]), np.array([[-1.0], [1.0]]), 1e-6 * np.eye(1), -np.ones(1), np.ones(1)
    ... )
    >>> d.round(5).tolist(), multipliers.round(3).tolist(), round(t, 5)
    ([0.5], [0.25, 0.25], -0.5)
    """
    m, n = A.shape
    inverse = _inverse_of_lower(_lower_factor(H))
    E = np.zeros((n + 2, m + 2 * n))
    E[:n] = np.hstack([-inverse @ A.T, inverse, -inverse])
    E[n, :m] = 1.0
    E[n + 1] = np.concatenate([c + 1.0, low, -high])
    target = np.zeros(n + 2)
    target[n + 1] = 1.0
    try:
        u, _ = nnls(E, target)
    except RuntimeError:  # went round in circles between all but equal sets: no step, and the descent ends here
        u = np.zeros(m + 2 * n)
    residual = E @ u - target
    d = np.clip(-inverse.T @ residual[:n] / residual[n + 1], low, high)
    return d, u[:m] / -residual[n + 1], float((c + A @ d).max())


@njit(error_model="numpy")
def _lower_factor(H):
    """Cholesky's L; a pivot that rounding made vanish is held at 10⁻¹² of its diagonal, so that H may be all but singular."""
    n = len(H)
    L = np.zeros((n, n))
    for j in range(n):
        pivot = H[j, j]
        for k in range(j):
            pivot -= L[j, k] ** 2
        L[j, j] = np.sqrt(max(pivot, _SMALLEST_PIVOT * H[j, j]))
        for i in range(j + 1, n):
            total = H[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            L[i, j] = total / L[j, j]
    return L


@njit(error_model="numpy")
def _inverse_of_lower(L):
    n = len(L)
    inverse = np.zeros((n, n))
    for j in range(n):
        inverse[j, j] = 1.0 / L[j, j]
        for i in range(j + 1, n):
            total = 0.0
            for k in range(j, i):
                total += L[i, k] * inverse[k, j]
            inverse[i, j] = -total / L[i, i]
    return inverse
