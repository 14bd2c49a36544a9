"""The prediction error criterion: innovations of a model on data, their gradient, and Gauss–Newton blocks.

    e(t) = D(q)/C(q) [A(q) (y(t) − y₀) − B(q)/F(q) u(t) − x(t)]

with a level y₀ and the free response x = i(q)/F(q) δ(t) of the states that the system brings into each record. Every
column of the gradient is a delayed copy of one of five filtered signals, so a step costs O(n p) for filtering and O(n p²) for
the normal equations.

Reference: L. Ljung, *System Identification*, 2nd ed. 1999, section 10.3; (1.101)–(1.104) of the source.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.linear_models.prediction_error.data import Signals
from residuum.identification.linear_models.prediction_error.filtering import filtered
from residuum.identification.linear_models.prediction_error.polynomials import Orders, Polynomials


@dataclass(frozen=True, eq=False)
class Normal:
    """Gauss–Newton blocks at one point: `cost` = Σ e², `gram` = ψᵀψ, `gradient` = ψᵀe (ψ = −∂e/∂θ), `n` rows used."""

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
        return [self._innovation(polynomials, x, number)[0][self.skip :] for number in range(len(self.data.pairs))]

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

    def _innovation(self, p: Polynomials, x: FloatArray, number: int) -> tuple[FloatArray, FloatArray, FloatArray]:
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

    def _with_gradient(self, p: Polynomials, x: FloatArray, number: int) -> tuple[FloatArray, FloatArray]:
        """(e, ψ) of one record, rows without a past left out; ψ = −∂e/∂x."""
        o = self.orders
        u, y = self.data.pairs[number]
        e, w, v = self._innovation(p, x, number)
        n = len(y)
        y0 = float(x[o.count]) if self.level else 0.0
        by_fc = _over(p.f, p.c)
        psi = np.empty((n, o.count + int(self.level) + self.free))
        at = 0
        for signal, first, count in (
            (-filtered(p.d, p.c, y - y0) if o.na else None, 1, o.na),
            (filtered(p.d, by_fc, u) if o.nb else None, o.delay, o.nb),
            (-filtered(p.d, by_fc, w) if o.nf else None, 1, o.nf),
            (filtered([1.0], p.c, e) if o.nc else None, 1, o.nc),
            (-filtered([1.0], p.c, v) if o.nd else None, 1, o.nd),
        ):
            if signal is not None:
                _delayed(signal, first, psi[:, at : at + count])
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
