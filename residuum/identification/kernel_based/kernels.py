"""Prior covariances of impulse responses."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt
from scipy import linalg

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput

# What a prior covariance of an impulse response is: P = λ K(η), with the factor that keeps it
# well conditioned.


@dataclass(frozen=True)
class Decay:
    """A decay per sample, 0 < α < 1, searched as x = ln τ with the time constant τ = −1/ln α in
    samples.
    """

    name: str = "alpha"
    longest: float = 1e5

    @property
    def bounds(self) -> tuple[float, float]:
        """Range of x."""
        # τ = 0.2 samples is α = e⁻⁵: of a faster decay one coefficient is all there is.
        return math.log(0.2), math.log(self.longest)

    def value(self, x: float) -> float:
        """α = exp(−e^{−x})."""
        return math.exp(-math.exp(-x))

    def free(self, value: float) -> float:
        """x of α."""
        return -math.log(-math.log(value))

    def slope(self, x: float) -> float:
        """dα/dx."""
        return self.value(x) * math.exp(-x)


@dataclass(frozen=True)
class Correlation:
    """A correlation of neighbours, −1 < ρ < 1, searched as x = artanh ρ."""

    name: str = "rho"

    @property
    def bounds(self) -> tuple[float, float]:
        """Range of x."""
        # tanh 9 is 1 less 3·10⁻⁸; at ±1 the prior would be singular.
        return -9.0, 9.0

    def value(self, x: float) -> float:
        """ρ = tanh x."""
        return math.tanh(x)

    def free(self, value: float) -> float:
        """x of ρ."""
        return math.atanh(value)

    def slope(self, x: float) -> float:
        """dρ/dx."""
        return 1.0 - math.tanh(x) ** 2


HyperParameter = Decay | Correlation


class Kernel(ABC):
    """A prior covariance K(η) of m impulse-response coefficients, up to the scale λ."""

    name: ClassVar[str]
    parameters: ClassVar[tuple[HyperParameter, ...]]

    @abstractmethod
    def matrix(self, m: int, eta: npt.ArrayLike) -> FloatArray:
        """K(η), shape (m, m)."""

    @abstractmethod
    def factor(self, m: int, eta: npt.ArrayLike) -> tuple[FloatArray, list[FloatArray]]:
        """F with F Fᵀ = K, and for each hyper-parameter E_k = F⁻¹ (∂K/∂η_k) F⁻ᵀ, all of shape (m,
        m).
        """

    def check(self, m: int, eta: npt.ArrayLike) -> FloatArray:
        """`eta` as an array; BadInput when its length or a value does not suit the kernel."""
        eta = np.atleast_1d(np.asarray(eta, dtype=float))
        if eta.shape != (len(self.parameters),) or m < 1:
            names = ", ".join(item.name for item in self.parameters)
            raise BadInput(
                f"kernel {self.name}: needs an order ≥ 1 and the hyper-parameters {names}; got"
                f" order {m}, {eta.tolist()}"
            )
        for item, value in zip(self.parameters, eta, strict=True):
            lower = 0.0 if isinstance(item, Decay) else -1.0
            if not lower < value < 1.0:
                raise BadInput(
                    f"kernel {self.name}, {item.name}: is {value}; must lie between {lower:g} and 1"
                )
        return eta


class DiagonalKernel(Kernel):
    """A kernel that is diagonal in a fixed basis, K = U diag(w(η)) Uᵀ: one diagonal then gives the
    whole gradient.
    """

    @abstractmethod
    def to_basis(self, array: FloatArray) -> FloatArray:
        """Uᵀ applied along the first axis."""

    @abstractmethod
    def from_basis(self, array: FloatArray) -> FloatArray:
        """U applied along the first axis."""

    @abstractmethod
    def log_variances(self, m: int, eta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """ln w, shape (m,), and its derivatives by η, shape (len(η), m)."""

    def factor(self, m: int, eta: npt.ArrayLike) -> tuple[FloatArray, list[FloatArray]]:
        """F = U diag(w)^½; E_k = diag(∂ ln w/∂η_k)."""
        log_w, slopes = self.log_variances(m, self.check(m, eta))
        return self.from_basis(np.diag(np.exp(0.5 * log_w))), [np.diag(slope) for slope in slopes]


# DI: the diagonal kernel.


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


# DC: the diagonal/correlated kernel.


class DiagonalCorrelated(Kernel):
    """K_ij = α^((i+j)/2) ρ^|i−j|: decay and correlation of neighbours chosen apart; ρ = √α is the
    TC kernel.

    g_i = α^{i/2} x_i where x is a first-order autoregression run backwards from x_m, hence a closed
    triangular factor. Chen, Ohlsson, Ljung, Automatica 48 (2012) 1525–1535.

    >>> DiagonalCorrelated().matrix(2, [0.25, 0.5]).tolist()
    [[0.25, 0.0625], [0.0625, 0.0625]]
    """

    name: ClassVar[str] = "dc"
    parameters: ClassVar[tuple[HyperParameter, ...]] = (Decay(), Correlation())

    def matrix(self, m: int, eta: npt.ArrayLike) -> FloatArray:
        """K(η), shape (m, m)."""
        alpha, rho = self.check(m, eta)
        i = np.arange(1.0, m + 1.0)
        return np.asarray(
            alpha ** (np.add.outer(i, i) / 2) * rho ** np.abs(np.subtract.outer(i, i))
        )

    def factor(self, m: int, eta: npt.ArrayLike) -> tuple[FloatArray, list[FloatArray]]:
        """F = diag(α^{i/2}) T with T the factor of the autoregression; E_α, E_ρ in closed form."""
        alpha, rho = self.check(m, eta)
        i = np.arange(1.0, m + 1.0)
        T, dT = _autoregression_factor(m, rho)
        by_alpha = _whiten((i / (2 * alpha))[:, None] * T, rho)
        by_rho = _whiten(dT, rho)
        return alpha ** (i / 2)[:, None] * T, [by_alpha + by_alpha.T, by_rho + by_rho.T]


def _autoregression_factor(m: int, rho: float) -> tuple[FloatArray, FloatArray]:
    """Upper triangular T with T Tᵀ = ρ^|i−j|, from x_i = ρ x_{i+1} + √(1−ρ²) w_i, x_m = w_m; and
    ∂T/∂ρ.
    """
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


# SS: the second-order stable spline kernel.

# The correlation of a twice smooth process is singular to rounding for slow decays; this much white
# prior, relative to each variance, keeps its Cholesky factor.
_NUGGET = 1e-12


class StableSpline(Kernel):
    """K_ij = α^(i+j+max(i,j))/2 − α^(3 max(i,j))/6: an integrated Wiener process in the time α^i,
    smoother than TC.

    Pillonetto, De Nicolao, Automatica 46 (2010) 81–93. Written as D C D with D = diag(α^{3i/2}/√3)
    and the stationary correlation C_ij = (3 α^{|i−j|/2} − α^{3|i−j|/2})/2, it can be factored at
    any order without underflow.

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
        return (alpha ** (1.5 * i) / np.sqrt(3))[:, None] * T, [
            by_scale + by_scale.T + by_correlation
        ]


# TC: the tuned/correlated kernel, also known as first-order stable spline.


class TunedCorrelated(DiagonalKernel):
    """K_ij = α^max(i,j), i, j = 1…m: responses that decay like α^(i/2), neighbours correlated.

    The increments d of g_i = Σ_{k≥i} d_k are independent with variance w_k = α^k − α^{k+1} (k < m),
    w_m = α^m, so the kernel is diagonal in first-difference coordinates. Chen, Ohlsson, Ljung,
    Automatica 48 (2012) 1525–1535; (2.19) of the source.

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
        # By log1p, for α of a slow decay is 1 less a small number; in logarithms, for α^k
        # underflows.
        log_w, slope = k * np.log(alpha) + np.log1p(-alpha), k / alpha - 1.0 / (1.0 - alpha)
        log_w[-1], slope[-1] = m * np.log(alpha), m / alpha
        return log_w, slope[None]


KERNELS: dict[str, Kernel] = {
    "tc": TunedCorrelated(),
    "dc": DiagonalCorrelated(),
    "ss": StableSpline(),
    "di": Diagonal(),
}
