"""The prediction error criterion: innovations of a model on data, their gradient, and Gauss–Newton
blocks.

    e(t) = D(q)/C(q) [A(q) (y(t) − y₀) − B(q)/F(q) u(t) − x(t)]

with a level y₀ and the free response x = i(q)/F(q) δ(t) of the states that the system brings into
each record. Every column of the gradient is a delayed copy of one of five filtered signals, so a
step costs O(n p) for filtering and O(n p²) for the normal equations.

Reference: L. Ljung, *System Identification*, 2nd ed. 1999, section 10.3; (1.101)–(1.104) of the
source.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput
from residuum.identification.linear_models.prediction_error.data import Signals
from residuum.identification.linear_models.schur import is_schur

# Filtering of a signal by a rational filter in q⁻¹.


def filtered(b: npt.ArrayLike, a: npt.ArrayLike, x: FloatArray) -> FloatArray:
    """b(q⁻¹)/a(q⁻¹) x from rest, shape of `x`; an FIR filter is a convolution, which is several
    times faster.
    """
    b, a = np.atleast_1d(np.asarray(b, dtype=float)), np.atleast_1d(np.asarray(a, dtype=float))
    if len(a) > 1:
        return np.asarray(lfilter(b, a, x))
    if len(b) == 1:
        return np.asarray(b[0] / a[0] * x)
    return np.convolve(b / a[0], x)[: len(x)]


# The polynomials of a linear model A(q) y = B(q)/F(q) u + C(q)/D(q) e, and their orders.

LONGEST_POLYNOMIAL = 200
_INSIDE = 0.9999  # modulus to which a reflected root on the unit circle itself is moved


@dataclass(frozen=True)
class Orders:
    """Orders of the polynomials, and the delay n_k of the input in samples.

    `nb` counts the coefficients of B (b₀ acts at lag n_k); the others count coefficients after the
    leading 1.

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
                raise BadInput(
                    f"Orders, {name}: is {value!r}; must be a whole number from 0 to"
                    f" {LONGEST_POLYNOMIAL}"
                )
        if self.na + self.nb + self.nf + self.nc + self.nd == 0:
            raise BadInput("Orders: all are zero; at least one polynomial must have coefficients")

    def __str__(self) -> str:
        """Orders as a reader wants them: only those that the structure has.

        >>> str(Orders(nb=2, nf=2))
        'nb = 2, nf = 2, nk = 1'
        """
        parts = [
            f"{name} = {value}" for name, value in vars(self).items() if name != "delay" and value
        ]
        return ", ".join([*parts, f"nk = {self.delay}"])

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
    """Coefficients in ascending powers of q⁻¹: `a`, `f`, `c`, `d` begin with 1, `b[0]` acts at lag
    `orders.delay`.
    """

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
        return cls(
            orders, *(np.r_[1.0, a], np.asarray(b), np.r_[1.0, f], np.r_[1.0, c], np.r_[1.0, d])
        )

    @property
    def vector(self) -> FloatArray:
        """θ = [a₁… b₀… f₁… c₁… d₁…], shape (count,)."""
        return np.concatenate([self.a[1:], self.b, self.f[1:], self.c[1:], self.d[1:]])

    @property
    def predictor_is_stable(self) -> bool:
        """Whether F and C, by which the predictor divides, have all roots inside the unit
        circle.
        """
        return is_schur(self.f) and is_schur(self.c)

    @property
    def delayed_b(self) -> FloatArray:
        """B with its delay as leading zeros, never empty."""
        return np.concatenate([np.zeros(self.orders.delay), self.b]) if self.b.size else np.zeros(1)


def reflected(polynomial: FloatArray) -> FloatArray:
    """A monic polynomial with its roots outside the unit circle replaced by their mirror images
    1/z̄.

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


@dataclass(frozen=True, eq=False)
class Normal:
    """Gauss–Newton blocks at one point: `cost` = Σ e², `gram` = ψᵀψ, `gradient` = ψᵀe (ψ = −∂e/∂θ),
    `n` rows used.
    """

    cost: float
    gram: FloatArray
    gradient: FloatArray
    n: int


class Criterion:
    """Sum of squared innovations as a function of [θ, y₀, free responses of every record].

    Parameters
    ----------
    data : Signals
    orders : Orders
    level : bool
        Whether the level y₀ is a parameter.
    """

    def __init__(self, data: Signals, orders: Orders, *, level: bool = True) -> None:
        self.data, self.orders, self.level = data, orders, level
        self.free = orders.nf
        self.skip = orders.memory if orders.na else (orders.memory if orders.nf == 0 else 0)

    @property
    def size(self) -> int:
        """Number of parameters, nuisance ones (level, free responses) included."""
        return self.orders.count + int(self.level) + self.free * len(self.data.pairs)

    def start(self, theta: FloatArray) -> FloatArray:
        """θ with all nuisance parameters zero."""
        return np.concatenate([theta, np.zeros(self.size - len(theta))])

    def polynomials(self, x: FloatArray) -> Polynomials:
        """The polynomials of a parameter vector."""
        return Polynomials.from_vector(x, self.orders)

    def cost(self, x: FloatArray) -> float:
        """Σ e²; infinite where the predictor is unstable or overflows."""
        polynomials = self.polynomials(x)
        if not polynomials.predictor_is_stable:
            return np.inf
        with np.errstate(over="ignore", invalid="ignore"):
            total = sum(float(e @ e) for e in self.innovations(x))
        return total if np.isfinite(total) else np.inf

    def innovations(self, x: FloatArray) -> list[FloatArray]:
        """e of every record without the samples whose past is not in it."""
        polynomials = self.polynomials(x)
        return [
            self._innovation(polynomials, x, number)[0][self.skip :]
            for number in range(len(self.data.pairs))
        ]

    def normal(self, x: FloatArray) -> Normal:
        """Cost and Gauss–Newton blocks."""
        polynomials = self.polynomials(x)
        gram, gradient, cost, n = np.zeros((self.size, self.size)), np.zeros(self.size), 0.0, 0
        for number in range(len(self.data.pairs)):
            e, psi = self._with_gradient(polynomials, x, number)
            columns = self._columns(number)
            gram[np.ix_(columns, columns)] += psi.T @ psi
            gradient[columns] += psi.T @ e
            cost += float(e @ e)
            n += len(e)
        return Normal(cost, gram, gradient, n)

    def _columns(self, number: int) -> npt.NDArray[np.intp]:
        shared = self.orders.count + int(self.level)
        return np.r_[np.arange(shared), shared + number * self.free + np.arange(self.free)]

    def _innovation(
        self, p: Polynomials, x: FloatArray, number: int
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(e, w = B/F u + free response, v = A (y − y₀) − w)."""
        u, y = self.data.pairs[number]
        y0 = float(x[self.orders.count]) if self.level else 0.0
        w = filtered(p.delayed_b, p.f, u) if self.orders.nb else np.zeros(len(y))
        if self.free:
            w = w + filtered(p.f[:1], p.f, self._pulses(x, number, len(y)))
        v = filtered(p.a, [1.0], y - y0) - w
        return np.asarray(filtered(p.d, p.c, v)), np.asarray(w), np.asarray(v)

    def _pulses(self, x: FloatArray, number: int, n: int) -> FloatArray:
        first = self.orders.count + int(self.level) + number * self.free
        pulses = np.zeros(n)
        pulses[: min(self.free, n)] = x[first : first + min(self.free, n)]
        return pulses

    def _with_gradient(
        self, p: Polynomials, x: FloatArray, number: int
    ) -> tuple[FloatArray, FloatArray]:
        """(e, ψ) of one record, rows without a past left out; ψ = −∂e/∂x."""
        o = self.orders
        u, y = self.data.pairs[number]
        e, w, v = self._innovation(p, x, number)
        n = len(y)
        y0 = float(x[o.count]) if self.level else 0.0
        by_fc = _over(p.f, p.c)
        psi = np.empty((n, o.count + int(self.level) + self.free))
        at = 0
        # of each polynomial: its filter's numerator, denominator, input and sign, the lag of its
        # first coefficient, and how many it has; the columns are in the order of θ
        for numerator, denominator, signal, sign, first, count in (
            (p.d, p.c, y - y0, -1.0, 1, o.na),
            (p.d, by_fc, u, 1.0, o.delay, o.nb),
            (p.d, by_fc, w, -1.0, 1, o.nf),
            ([1.0], p.c, e, 1.0, 1, o.nc),
            ([1.0], p.c, v, -1.0, 1, o.nd),
        ):
            if count:
                column = sign * filtered(numerator, denominator, signal)
                _delayed(column, first, psi[:, at : at + count])
            at += count
        if self.level:
            psi[:, at] = filtered(np.convolve(p.d, p.a), p.c, np.ones(n))
            at += 1
        if self.free:
            pulse = np.zeros(n)
            pulse[0] = 1.0
            _delayed(filtered(p.d, by_fc, pulse), 0, psi[:, at : at + self.free])
        return e[self.skip :], psi[self.skip :]


def _over(f: FloatArray, c: FloatArray) -> FloatArray:
    return np.convolve(f, c) if len(c) > 1 else f


def _delayed(signal: FloatArray, first: int, columns: FloatArray) -> None:
    """Write the signal delayed by first, first + 1, … into the columns."""
    n = len(signal)
    for k in range(columns.shape[1]):
        lag = min(first + k, n)
        columns[:lag, k] = 0.0
        columns[lag:, k] = signal[: n - lag]
