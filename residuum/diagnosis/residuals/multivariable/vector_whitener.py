"""A vector residual made white: a vector autoregression, and the root of its innovations' covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.errors import BadRecord

_HIGHEST = 10
_ROWS_A_VALUE = 5
"""Rows of the regression that each of its unknowns needs."""


@dataclass(frozen=True, eq=False)
class VectorWhitener:
    """s(t) = L⁻¹ (r(t) − A₁ r(t−1) − … − A_k r(t−k)), of unit covariance while healthy.

    Parameters
    ----------
    past : array, shape (k, r, r)
        A₁ … A_k; k may be 0.
    root : array, shape (r, r)
        L, lower triangular: L Lᵀ is the covariance of the innovations [unit of the residual²].
    n : int
        Healthy samples it was fitted on.
    """

    past: FloatArray
    root: FloatArray
    n: int = 0

    @classmethod
    def none(cls, size: int) -> VectorWhitener:
        """The one that changes nothing."""
        return cls(np.zeros((0, size, size)), np.eye(size))

    @property
    def innovation_std(self) -> FloatArray:
        """Standard deviations of the innovations, shape (r,)."""
        return np.asarray(np.sqrt(np.sum(self.root**2, axis=1)))

    def after(self, impulse: FloatArray) -> FloatArray:
        """Impulse response of the whitener behind a filter with `impulse`, shape (length, r, p) → (length + k, r, p)."""
        made = np.concatenate([impulse, np.zeros((len(self.past), *impulse.shape[1:]))])
        for k, A in enumerate(self.past, start=1):
            made[k : k + len(impulse)] -= A @ impulse
        return np.linalg.solve(self.root, made)


def fit_whitener(residuals: Sequence[FloatArray]) -> VectorWhitener:
    """Least squares over healthy residuals, each of shape (n, r) with NaN where it is not known; order by BIC up to 10.

    Raises BadRecord where too few samples are known, or a residual does not move.
    """
    orders = [order for order in range(_HIGHEST + 1) if _enough(residuals, order)]
    if not orders:
        raise BadRecord("healthy records: too short beyond the model's memory to know the residual's noise; give longer ones")
    now, past = _all_rows(residuals, orders[-1])  # the same for all orders that are compared
    size = now.shape[1]
    order = min(orders, key=lambda k: _schwarz(now, past[:, : k * size]))
    now, past = _all_rows(residuals, order)
    A, covariance = _regressed(now, past)
    return VectorWhitener(A.reshape(size, order, size).transpose(1, 0, 2), np.asarray(np.linalg.cholesky(covariance)), len(now))


def _enough(residuals: Sequence[FloatArray], order: int) -> bool:
    now, _ = _all_rows(residuals, order)
    return len(now) >= max(_ROWS_A_VALUE * (order + 1) * now.shape[1], 50)


def _schwarz(now: FloatArray, past: FloatArray) -> float:
    """Schwarz's criterion of the regression of r(t) on its past."""
    A, _ = _regressed(now, past)
    left = now - past @ A.T
    return len(now) * float(np.linalg.slogdet(left.T @ left / len(now))[1]) + A.size * float(np.log(len(now)))


def _regressed(now: FloatArray, past: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Coefficients of r(t) by its past, and the covariance of what is left."""
    A = np.asarray(np.linalg.lstsq(past, now, rcond=None)[0].T) if past.shape[1] else np.zeros((now.shape[1], 0))
    left = now - past @ A.T
    covariance = np.asarray(left.T @ left / (len(now) - past.shape[1]))
    sign, log_determinant = np.linalg.slogdet(covariance)
    if sign <= 0 or not np.isfinite(log_determinant):
        raise BadRecord("healthy records: a residual does not move, or two of them move as one")
    return A, covariance


def _all_rows(residuals: Sequence[FloatArray], order: int) -> tuple[FloatArray, FloatArray]:
    rows = [_rows(part, order) for part in residuals]
    return np.concatenate([now for now, _ in rows]), np.concatenate([past for _, past in rows])


def _rows(r: FloatArray, order: int) -> tuple[FloatArray, FloatArray]:
    """r(t), and r(t−1) … r(t−order) beside each other, where all are known."""
    now = r[order:]
    past = np.concatenate([r[order - k : len(r) - k] for k in range(1, order + 1)], axis=1) if order else np.zeros((len(r), 0))
    good = np.isfinite(now).all(axis=1) & np.isfinite(past).all(axis=1)
    return now[good], past[good]
