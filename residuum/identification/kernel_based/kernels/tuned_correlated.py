"""TC: the tuned/correlated kernel, also known as first-order stable spline."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.kernel_based.kernels.base import Decay, DiagonalKernel, HyperParameter


class TunedCorrelated(DiagonalKernel):
    """K_ij = α^max(i,j), i, j = 1…m: responses that decay like α^(i/2), neighbours correlated.

    The increments d of g_i = Σ_{k≥i} d_k are independent with variance w_k = α^k − α^{k+1} (k < m), w_m = α^m, so the
    kernel is diagonal in first-difference coordinates. Chen, Ohlsson, Ljung, Automatica 48 (2012) 1525–1535; (2.19)
    of the source.

    >>> TunedCorrelated().matrix(2, [0.5]).tolist()
    [[0.5, 0.25], [0.25, 0.25]]
    """

    name: ClassVar[str] = "tc"
    parameters: ClassVar[tuple[HyperParameter, ...]] = (Decay(),)

    def matrix(self, m: int, eta: npt.ArrayLike) -> FloatArray:
        """K(η), shape (m, m)."""
        (alpha,) = self.check(m, eta)
        i = np.arange(1, m + 1)
        return np.asarray(alpha ** np.maximum.outer(i, i))

    def to_basis(self, array: FloatArray) -> FloatArray:
        """Running sums from the first coefficient on."""
        return np.asarray(np.cumsum(array, axis=0))

    def from_basis(self, array: FloatArray) -> FloatArray:
        """Running sums from the last coefficient back."""
        return np.asarray(np.cumsum(array[::-1], axis=0)[::-1])

    def log_variances(self, m: int, eta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """ln w_k = k ln α + ln(1 − α), without the last term for k = m; and the derivative by α."""
        alpha = eta[0]
        k = np.arange(1.0, m + 1.0)
        log_w, slope = k * np.log(alpha) + np.log1p(-alpha), k / alpha - 1.0 / (1.0 - alpha)
        log_w[-1], slope[-1] = m * np.log(alpha), m / alpha
        return log_w, slope[None]
