"""SS: the second-order stable spline kernel."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import numpy.typing as npt
from scipy import linalg

from residuum.array_types import FloatArray
from residuum.identification.kernel_based.kernels.base import Decay, HyperParameter, Kernel

# The correlation of a twice smooth process is singular to rounding for slow decays; this much white
# prior, relative to each variance, keeps its Cholesky factor.
_NUGGET = 1e-12


class StableSpline(Kernel):
    """K_ij = α^(i+j+max(i,j))/2 − α^(3 max(i,j))/6: an integrated Wiener process in the time α^i, smoother than TC.

    Pillonetto, De Nicolao, Automatica 46 (2010) 81–93. Written as D C D with D = diag(α^{3i/2}/√3) and the stationary
    correlation C_ij = (3 α^{|i−j|/2} − α^{3|i−j|/2})/2, it can be factored at any order without underflow.

    >>> StableSpline().matrix(1, [0.5]).round(6).tolist()
    [[0.041667]]
    """

    name: ClassVar[str] = "ss"
    parameters: ClassVar[tuple[HyperParameter, ...]] = (Decay(longest=3e3),)

    def matrix(self, m: int, eta: npt.ArrayLike) -> FloatArray:
        """K(η), shape (m, m)."""
        (alpha,) = self.check(m, eta)
        i = np.arange(1, m + 1)
        late = np.maximum.outer(i, i)
        return np.asarray(alpha ** (np.add.outer(i, i) + late) / 2 - alpha ** (3 * late) / 6)

    def factor(self, m: int, eta: npt.ArrayLike) -> tuple[FloatArray, list[FloatArray]]:
        """F = D chol(C); E_α from the derivative of D and of C."""
        (alpha,) = self.check(m, eta)
        i, lag = np.arange(1.0, m + 1.0), np.arange(float(m))
        C = linalg.toeplitz(1.5 * alpha ** (lag / 2) - 0.5 * alpha ** (1.5 * lag))
        dC = linalg.toeplitz(0.75 * lag * (alpha ** (lag / 2 - 1) - alpha ** (1.5 * lag - 1)))
        T = np.linalg.cholesky(C + _NUGGET * np.eye(m))
        scaled = (3 * i / (2 * alpha))[:, None] * T
        by_scale = linalg.solve_triangular(T, scaled, lower=True, check_finite=False)
        half = linalg.solve_triangular(T, dC, lower=True, check_finite=False)
        by_correlation = linalg.solve_triangular(T, half.T, lower=True, check_finite=False)
        return (alpha ** (1.5 * i) / np.sqrt(3))[:, None] * T, [by_scale + by_scale.T + by_correlation]
