"""One step of a minimax problem: the quadratic programme in its epigraph form."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.linalg.lapack import dpotrf, dtrtri
from scipy.optimize import nnls

FloatArray = npt.NDArray[np.float64]


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
    inverse = dtrtri(dpotrf(H, lower=1)[0], lower=1)[0]  # L⁻¹; LAPACK itself, because n is small and calls are many
    E = np.zeros((n + 2, m + 2 * n))
    E[:n, :m] = -inverse @ A.T
    E[:n, m : m + n] = inverse
    E[:n, m + n :] = -inverse
    E[n, :m] = 1.0
    E[n + 1, :m] = c + 1.0
    E[n + 1, m : m + n] = low
    E[n + 1, m + n :] = -high
    target = np.zeros(n + 2)
    target[-1] = 1.0
    u, _ = nnls(E, target, maxiter=20 * E.shape[1])
    residual = E @ u - target
    d = np.clip(inverse.T @ (residual[:n] / -residual[-1]), low, high)
    return d, u[:m] / -residual[-1], float((c + A @ d).max())
