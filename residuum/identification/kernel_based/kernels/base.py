"""What a prior covariance of an impulse response is: P = λ K(η), with the factor that keeps it well conditioned."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput


@dataclass(frozen=True)
class Decay:
    """A decay per sample, 0 < α < 1, searched as x = ln τ with the time constant τ = −1/ln α in samples."""

    name: str = "alpha"
    longest: float = 1e5

    @property
    def bounds(self) -> tuple[float, float]:
        """Range of x."""
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
        """F with F Fᵀ = K, and for each hyper-parameter E_k = F⁻¹ (∂K/∂η_k) F⁻ᵀ, all of shape (m, m)."""

    def check(self, m: int, eta: npt.ArrayLike) -> FloatArray:
        """`eta` as an array; BadInput when its length or a value does not suit the kernel."""
        eta = np.atleast_1d(np.asarray(eta, dtype=float))
        if eta.shape != (len(self.parameters),) or m < 1:
            names = ", ".join(item.name for item in self.parameters)
            raise BadInput(
                f"kernel {self.name}: needs an order ≥ 1 and the hyper-parameters {names}; got order {m}, {eta.tolist()}"
            )
        for item, value in zip(self.parameters, eta, strict=True):
            lower = 0.0 if isinstance(item, Decay) else -1.0
            if not lower < value < 1.0:
                raise BadInput(f"kernel {self.name}, {item.name}: is {value}; must lie between {lower:g} and 1")
        return eta


class DiagonalKernel(Kernel):
    """A kernel that is diagonal in a fixed basis, K = U diag(w(η)) Uᵀ: one diagonal then gives the whole gradient."""

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
