"""DC: the diagonal/correlated kernel."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.kernel_based.kernels.base import Correlation, Decay, HyperParameter, Kernel


class DiagonalCorrelated(Kernel):
    """K_ij = α^((i+j)/2) ρ^|i−j|: decay and correlation of neighbours chosen apart; ρ = √α is the TC kernel.

    g_i = α^{i/2} x_i where x is a first-order autoregression run backwards from x_m, hence a closed triangular factor.
    Chen, Ohlsson, Ljung, Automatica 48 (2012) 1525–1535.

    >>> DiagonalCorrelated().matrix(2, [0.25, 0.5]).tolist()
    [[0.25, 0.0625], [0.0625, 0.0625]]
    """

    name: ClassVar[str] = "dc"
    parameters: ClassVar[tuple[HyperParameter, ...]] = (Decay(), Correlation())

    def matrix(self, m: int, eta: npt.ArrayLike) -> FloatArray:
        """K(η), shape (m, m)."""
        alpha, rho = self.check(m, eta)
        i = np.arange(1.0, m + 1.0)
        return np.asarray(alpha ** (np.add.outer(i, i) / 2) * rho ** np.abs(np.subtract.outer(i, i)))

    def factor(self, m: int, eta: npt.ArrayLike) -> tuple[FloatArray, list[FloatArray]]:
        """F = diag(α^{i/2}) T with T the factor of the autoregression; E_α, E_ρ in closed form."""
        alpha, rho = self.check(m, eta)
        i = np.arange(1.0, m + 1.0)
        T, dT = _autoregression_factor(m, rho)
        by_alpha = _whiten((i / (2 * alpha))[:, None] * T, rho)
        by_rho = _whiten(dT, rho)
        return alpha ** (i / 2)[:, None] * T, [by_alpha + by_alpha.T, by_rho + by_rho.T]


def _autoregression_factor(m: int, rho: float) -> tuple[FloatArray, FloatArray]:
    """Upper triangular T with T Tᵀ = ρ^|i−j|, from x_i = ρ x_{i+1} + √(1−ρ²) w_i, x_m = w_m; and ∂T/∂ρ."""
    c, k = np.sqrt(1.0 - rho**2), np.arange(m)
    power = rho**k
    slope = k * np.concatenate([[0.0], power[:-1]])
    lag = np.maximum(k - k[:, None], 0)
    T, dT = np.triu((power * c)[lag]), np.triu((slope * c - power * rho / c)[lag])
    T[:, -1], dT[:, -1] = power[::-1], slope[::-1]
    return T, dT


def _whiten(array: FloatArray, rho: float) -> FloatArray:
    """T⁻¹ array: w_i = (x_i − ρ x_{i+1})/√(1−ρ²), w_m = x_m."""
    whitened = array.copy()
    whitened[:-1] = (array[:-1] - rho * array[1:]) / np.sqrt(1.0 - rho**2)
    return whitened
