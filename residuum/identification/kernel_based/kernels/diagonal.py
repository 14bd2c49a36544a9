"""DI: the diagonal kernel."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.kernel_based.kernels.base import Decay, DiagonalKernel, HyperParameter


class Diagonal(DiagonalKernel):
    """K = diag(α^i), i = 1…m: responses that decay, neighbours independent (no smoothness).

    Chen, Ohlsson, Ljung, Automatica 48 (2012) 1525–1535.

    >>> Diagonal().matrix(2, [0.5]).tolist()
    [[0.5, 0.0], [0.0, 0.25]]
    """

    name: ClassVar[str] = "di"
    parameters: ClassVar[tuple[HyperParameter, ...]] = (Decay(),)

    def matrix(self, m: int, eta: npt.ArrayLike) -> FloatArray:
        """K(η), shape (m, m)."""
        (alpha,) = self.check(m, eta)
        return np.diag(alpha ** np.arange(1.0, m + 1.0))

    def to_basis(self, array: FloatArray) -> FloatArray:
        """The array itself."""
        return array

    def from_basis(self, array: FloatArray) -> FloatArray:
        """The array itself."""
        return array

    def log_variances(self, m: int, eta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """ln w_i = i ln α and its derivative."""
        i = np.arange(1.0, m + 1.0)
        return i * np.log(eta[0]), (i / eta[0])[None]
