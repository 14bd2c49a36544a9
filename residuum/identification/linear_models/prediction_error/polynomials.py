"""The polynomials of a linear model A(q) y = B(q)/F(q) u + C(q)/D(q) e, and their orders."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput
from residuum.identification.linear_models.schur import is_schur

LONGEST_POLYNOMIAL = 200
_INSIDE = 0.9999


@dataclass(frozen=True)
class Orders:
    """Orders of the polynomials, and the delay n_k of the input in samples.

    `nb` counts the coefficients of B (b₀ acts at lag n_k); the others count coefficients after the leading 1.

    Raises BadInput for a negative or too large order.
    """

    na: int = 0
    nb: int = 0
    nf: int = 0
    nc: int = 0
    nd: int = 0
    delay: int = 1

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (isinstance(value, int) and 0 <= value <= LONGEST_POLYNOMIAL):
                raise BadInput(f"Orders, {name}: is {value!r}; must be a whole number from 0 to {LONGEST_POLYNOMIAL}")
        if self.na + self.nb + self.nf + self.nc + self.nd == 0:
            raise BadInput("Orders: all are zero; at least one polynomial must have coefficients")

    @property
    def count(self) -> int:
        """Number of coefficients."""
        return self.na + self.nb + self.nf + self.nc + self.nd

    @property
    def memory(self) -> int:
        """Samples of the past that the regressor of an ARX model needs."""
        return max(self.na, self.nb + self.delay - 1 if self.nb else 0)


@dataclass(frozen=True, eq=False)
class Polynomials:
    """Coefficients in ascending powers of q⁻¹: `a`, `f`, `c`, `d` begin with 1, `b[0]` acts at lag `orders.delay`."""

    orders: Orders
    a: FloatArray
    b: FloatArray
    f: FloatArray
    c: FloatArray
    d: FloatArray

    @classmethod
    def from_vector(cls, theta: FloatArray, orders: Orders) -> Polynomials:
        """The polynomials of θ = [a₁… b₀… f₁… c₁… d₁…]."""
        cuts = np.cumsum([orders.na, orders.nb, orders.nf, orders.nc])
        a, b, f, c, d = np.split(theta[: orders.count], cuts)
        return cls(orders, *(np.r_[1.0, a], np.asarray(b), np.r_[1.0, f], np.r_[1.0, c], np.r_[1.0, d]))

    @property
    def vector(self) -> FloatArray:
        """θ = [a₁… b₀… f₁… c₁… d₁…], shape (count,)."""
        return np.concatenate([self.a[1:], self.b, self.f[1:], self.c[1:], self.d[1:]])

    @property
    def predictor_is_stable(self) -> bool:
        """Whether F and C, by which the predictor divides, have all roots inside the unit circle."""
        return is_schur(self.f) and is_schur(self.c)

    @property
    def delayed_b(self) -> FloatArray:
        """B with its delay as leading zeros, never empty."""
        return np.concatenate([np.zeros(self.orders.delay), self.b]) if self.b.size else np.zeros(1)


def reflected(polynomial: FloatArray) -> FloatArray:
    """A monic polynomial with its roots outside the unit circle replaced by their mirror images 1/z̄.

    The modulus of its frequency response keeps its shape.

    >>> reflected(np.array([1.0, -2.0]))
    array([ 1. , -0.5])
    """
    if is_schur(polynomial):
        return polynomial
    roots = np.roots(polynomial)
    outside = np.abs(roots) >= 1.0
    roots[outside] = 1.0 / np.conj(roots[outside])
    roots *= np.minimum(1.0, _INSIDE / np.maximum(np.abs(roots), 1e-300))
    return np.asarray(np.real(np.poly(roots)), dtype=float)
