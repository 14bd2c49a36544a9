"""Bounds of the structured singular value µ for diagonal complex uncertainty."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

from residuum.identification.errors import BadInput

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]


def mu_bounds(M: npt.ArrayLike, *, starts: int = 6, seed: int = 0) -> tuple[float, float]:
    r"""(lower, upper) of :math:`\mu(M) = 1/\min\{\bar\sigma(\Delta): \det(I - M\Delta) = 0,\ \Delta\ \text{diagonal}\}`.

    .. math::
        \max_U \rho(U M) \le \mu(M) \le \min_D \bar\sigma(D M D^{-1}), \qquad U\ \text{diagonal unitary},\ D > 0\ \text{diagonal}

    The upper bound is convex in ln D and equals µ for up to three entries; the lower one is a local search from several phases.

    Parameters
    ----------
    M : array, shape (p, p)
        Response at one frequency; robust stability for all ‖Δ‖∞ < 1 needs µ ≤ 1 at every frequency, robust performance
        the same with one entry more for the performance (main loop theorem).
    starts, seed : int
        Of the lower bound's phases.

    Raises
    ------
    BadInput
        Not square or not finite.

    References
    ----------
    A. Packard, J. Doyle, *The complex structured singular value*, Automatica 29 (1993) 71–109.

    Examples
    --------
    >>> low, high = mu_bounds([[0.0, 4.0], [1.0, 0.0]])
    >>> round(low, 3), round(high, 3)
    (2.0, 2.0)
    """
    M = np.asarray(M, dtype=complex)
    if M.ndim != 2 or M.shape[0] != M.shape[1] or not np.isfinite(M).all():
        raise BadInput(
            f"structured singular value, M: has shape {M.shape}; must be square and finite"
        )
    upper = _scaled_norm(M)
    phases = np.random.default_rng(seed).uniform(0, 2 * np.pi, (starts, len(M)))
    lower = max(_spectral_radius(M, start) for start in phases)
    return min(lower, upper), upper


def _scaled_norm(M: ComplexArray) -> float:
    """min_D σ̄(D M D⁻¹) by quasi-Newton steps on ln D from the balanced scaling, whose slope is |u|² − |v|²."""

    def value(log_d: FloatArray) -> tuple[float, FloatArray]:
        d = np.exp(log_d)
        u, s, vh = np.linalg.svd(d[:, None] * M / d)
        return float(np.log(s[0] + 1e-300)), np.abs(u[:, 0]) ** 2 - np.abs(vh[0]) ** 2

    start = np.zeros(len(M))
    for _ in range(20):  # Osborne's balancing: rows and columns of equal size
        d = np.exp(start)
        size = np.abs(d[:, None] * M / d)
        np.fill_diagonal(size, 0.0)
        rows, columns = np.linalg.norm(size, axis=1), np.linalg.norm(size, axis=0)
        start -= 0.25 * np.log((rows + 1e-300) / (columns + 1e-300)).clip(-20, 20)
    best = min(minimize(value, x, jac=True, method="BFGS").fun for x in (start, np.zeros(len(M))))
    return float(np.exp(best))


def _spectral_radius(M: ComplexArray, phases: FloatArray) -> float:
    def value(phi: FloatArray) -> float:
        return -float(np.abs(np.linalg.eigvals(np.exp(1j * phi)[:, None] * M)).max())

    return -float(minimize(value, phases, method="BFGS").fun)
