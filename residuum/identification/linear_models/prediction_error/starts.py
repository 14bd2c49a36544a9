"""First values for the search: high-order ARX, realisation of its impulse response, two-stage
regression for the noise; and what a structure makes of them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import ClassVar

import numpy as np
from scipy.linalg import hankel

from residuum.array_types import FloatArray
from residuum.identification.linear_models.prediction_error.criterion import (
    Orders,
    Polynomials,
    filtered,
    reflected,
)
from residuum.identification.linear_models.prediction_error.data import Signals

_HIGHEST_ARX = 40
_REFINEMENTS = 6


def regression(data: Signals, orders: Orders) -> tuple[FloatArray, FloatArray]:
    """(Φ, y) of an ARX model over all records, shapes (rows, na + nb) and (rows,); no row reaches
    across a seam.
    """
    rows, targets = [], []
    for u, y in data.pairs:
        first = orders.memory
        if len(y) <= first:
            continue
        lagged = [-y[first - k : len(y) - k] for k in range(1, orders.na + 1)]
        lagged += [u[first - k : len(u) - k] for k in range(orders.delay, orders.delay + orders.nb)]
        rows.append(np.stack(lagged, axis=1))
        targets.append(y[first:])
    return np.concatenate(rows), np.concatenate(targets)


def least_squares_arx(data: Signals, orders: Orders) -> FloatArray:
    """θ = [a₁… b₀…] of an ARX model by linear least squares, shape (na + nb,); equation (1.87) of
    the source.
    """
    return least_squares(*regression(data, orders))


def least_squares(phi: FloatArray, target: FloatArray) -> FloatArray:
    """arg min ‖target − phi θ‖, by normal equations of unit columns where they are well
    conditioned, else by singular values.

    The normal equations cost one matrix product, a tenth of a decomposition of phi.
    """
    norm = np.linalg.norm(phi, axis=0)
    norm[norm == 0.0] = 1.0
    scaled = phi / norm
    gram = scaled.T @ scaled
    if np.linalg.cond(gram) < 1e10:
        return np.asarray(np.linalg.solve(gram, scaled.T @ target) / norm)
    return np.asarray(np.linalg.lstsq(scaled, target, rcond=None)[0] / norm)


class FirstValues:
    """What all starts of one data set share: a high-order ARX model, its impulse response and
    residuals.
    """

    def __init__(self, data: Signals, delay: int, highest: int) -> None:
        order = min(_HIGHEST_ARX, max(2 * highest + 8, 12), data.n // 10)
        self.data, self.delay = data, delay
        self.arx = Orders(na=max(order, 1), nb=max(order, 1), delay=delay)
        self.theta = least_squares_arx(data, self.arx)
        model = Polynomials.from_vector(self.theta, self.arx)
        length = 2 * max(2 * highest + 4, 24)
        self.impulse = np.asarray(
            filtered(model.b, reflected(model.a), np.r_[1.0, np.zeros(length - 1)])
        )
        self.left, self.singular, _ = np.linalg.svd(
            hankel(self.impulse[1 : length // 2 + 1], self.impulse[length // 2 : -1])
        )
        self.innovations = [
            filtered(model.a, [1.0], y) - filtered(model.delayed_b, [1.0], u) for u, y in data.pairs
        ]

    def plant(self, nb: int, nf: int) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Candidates (B, F): a realisation of the impulse response, and its refinement by iterated
        prefiltering.
        """
        f = reflected(self._realised_denominator(nf))
        b = self._numerator(f, nb)
        yield b, f
        yield self._prefiltered(f, nb)

    def _realised_denominator(self, order: int) -> FloatArray:
        """Characteristic polynomial of the balanced realisation of this order (S. Y. Kung,
        1978).
        """
        order = min(order, len(self.singular) - 1)
        observability = self.left[:, :order] * np.sqrt(self.singular[:order])
        A = np.linalg.lstsq(observability[:-1], observability[1:], rcond=None)[0]
        return np.asarray(np.real(np.poly(A)))

    def _numerator(self, f: FloatArray, nb: int) -> FloatArray:
        """B by least squares for a given F."""
        rows = [self._delayed(filtered([1.0], f, u), nb) for u, _ in self.data.pairs]
        return least_squares(np.concatenate(rows), np.concatenate([y for _, y in self.data.pairs]))

    def _prefiltered(self, f: FloatArray, nb: int) -> tuple[FloatArray, FloatArray]:
        """Steiglitz–McBride iteration: ARX on data filtered by 1/F, again and again."""
        nf, best = len(f) - 1, (np.inf, self._numerator(f, nb), f)
        for _ in range(_REFINEMENTS):
            prefiltered = tuple(
                (filtered([1.0], f, u), filtered([1.0], f, y)) for u, y in self.data.pairs
            )
            orders = Orders(na=nf, nb=nb, delay=self.delay)
            theta = least_squares_arx(Signals(prefiltered, 0.0, 0.0, 1.0, 1.0), orders)
            f = reflected(np.r_[1.0, theta[:nf]])
            b = self._numerator(f, nb)
            cost = sum(
                float(np.sum((y - filtered(np.r_[np.zeros(self.delay), b], f, u)) ** 2))
                for u, y in self.data.pairs
            )
            if cost < best[0]:
                best = (cost, b, f)
        return best[1], best[2]

    def noise(self, rests: list[FloatArray], nc: int, nd: int) -> tuple[FloatArray, FloatArray]:
        """(C, D) of an ARMA model of `rests` by two-stage regression (E. J. Hannan, J. Rissanen,
        1982).
        """
        long = Signals(tuple((np.zeros(len(v)), v) for v in rests), 0.0, 0.0, 1.0, 1.0)
        order = min(max(nc + nd + 8, 12), long.n // 10)
        a = np.r_[1.0, least_squares_arx(long, Orders(na=order))]
        guessed = Signals(tuple((filtered(a, [1.0], v), v) for v in rests), 0.0, 0.0, 1.0, 1.0)
        theta = (
            least_squares_arx(guessed, Orders(na=nd, nb=nc, delay=1)) if nc + nd else np.zeros(0)
        )
        return reflected(np.r_[1.0, theta[nd:]]), reflected(np.r_[1.0, theta[:nd]])

    def armax(self, na: int, nb: int, nc: int) -> FloatArray:
        """[a, b, c] by regression on past outputs, inputs and high-order ARX innovations."""
        rows, targets = [], []
        first = max(na, nb + self.delay - 1, nc) + self.arx.na
        for (u, y), e in zip(self.data.pairs, self.innovations, strict=True):
            lagged = [-y[first - k : len(y) - k] for k in range(1, na + 1)]
            lagged += [u[first - k : len(u) - k] for k in range(self.delay, self.delay + nb)]
            lagged += [e[first - k : len(e) - k] for k in range(1, nc + 1)]
            rows.append(np.stack(lagged, axis=1))
            targets.append(y[first:])
        theta = least_squares(np.concatenate(rows), np.concatenate(targets))
        return np.concatenate([theta[: na + nb], reflected(np.r_[1.0, theta[na + nb :]])[1:]])

    def _delayed(self, signal: FloatArray, count: int) -> FloatArray:
        lags = [
            np.concatenate([np.zeros(self.delay + k), signal[: len(signal) - self.delay - k]])
            for k in range(count)
        ]
        return np.stack(lags, axis=1)


class Structure(ABC):
    """A model structure of the family A y = B/F u + C/D e: which polynomials it has, and where its
    search starts.

    `linear` structures have a quadratic criterion: their start is already the minimum.
    """

    name: ClassVar[str]
    equation: ClassVar[str]
    linear: ClassVar[bool] = False
    has_input: ClassVar[bool] = True

    @abstractmethod
    def orders(self, order: int, delay: int) -> Orders:
        """The polynomial orders that one number means for this structure."""

    @abstractmethod
    def starts(self, first: FirstValues, orders: Orders) -> Iterator[FloatArray]:
        """First values of θ, the most promising first."""

    def parameters(self, data: Signals, orders: Orders) -> int:
        """Number of parameters that this data set must determine."""
        return orders.count
