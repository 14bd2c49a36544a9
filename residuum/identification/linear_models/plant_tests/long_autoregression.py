"""A long autoregression with input, the common ground of the tests: it needs no knowledge of orders, dead time or feedback.

A(q) y(t) = Σ_{j=0 or 1}^{Q} b_j u(t − j) + c + e(t),   A(q) = 1 + a₁ q⁻¹ + … + a_P q⁻ᴾ

by least squares, P by BIC. With lags enough e is white, and the estimates are consistent for open and closed loops alike (direct
method: Ljung, System Identification (1999), 13.4).

All comes from the Gram matrix and two Cholesky factors of it. With G = L Lᵀ and z = L⁻¹ Φᵀy, Σ z² of the last k columns is what
they explain beyond all others, so that nested models and tests of the first k weights are running sums.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add

import numpy as np
from scipy import linalg

from residuum.array_types import FloatArray
from residuum.identification.blas_threads import one_thread_if_small
from residuum.identification.errors import NotIdentifiable
from residuum.identification.kernel_based.gram import RegressionSums, regression_sums
from residuum.identification.record import Record

OUTPUT_LAGS = (2, 4, 8, 16, 30)
"""Candidates for P."""
SHORT_REACH, LONG_REACH = 120, 600
"""Input lags Q of a first look, and at most."""
_SAMPLES_A_LAG = 12
_FEWEST, _MOST = 120, 20_000
_RIDGE, _RESOLUTION = 1e-10, 1e-10


@dataclass(frozen=True, eq=False)
class LongAutoregression:
    """The estimate in signals of zero mean and unit power.

    Attributes
    ----------
    output_weights : array, shape (P,)
        α_i = −a_i, of y(t − i).
    input_weights : array, shape (Q + 1 − first_lag,)
        b_j from lag `first_lag` on.
    leading : array, shape (Q + 1 − first_lag,)
        θ₁ᵀ Σ₁₁⁻¹ θ₁ of the first 1, 2, … input weights, χ² where they are zero.
    factor : array, shape (P + Q + 1 − first_lag,) squared
        Lower Cholesky factor of the inverse of the covariance; the columns are α₁ … α_P, then b from the last lag to the first.
    first_lag : int
        0 where the input may act within its own sample, else 1.
    inputs, innovations : list of array
        u and e of each record, shape (n,); NaN where unknown.
    resolved : bool
        Whether e is more than rounding.
    """

    output_weights: FloatArray
    input_weights: FloatArray
    leading: FloatArray
    factor: FloatArray
    first_lag: int
    inputs: list[FloatArray]
    innovations: list[FloatArray]
    resolved: bool

    def spread(self, of_outputs: FloatArray, of_inputs: FloatArray) -> float:
        """Standard deviation of a sum of weights with these factors."""
        factors = np.concatenate([of_outputs, of_inputs[::-1]])
        return float(np.linalg.norm(linalg.solve_triangular(self.factor, factors, lower=True)))


@one_thread_if_small(SHORT_REACH)
def long_autoregression(
    records: Sequence[Record], input: str, output: str, *, first_lag: int = 1, reach: int = SHORT_REACH
) -> LongAutoregression:
    """Estimate it over all records, each with a level of its own; at most their first 20 000 samples count.

    Parameters
    ----------
    first_lag : {0, 1}
    reach : int
        Input lags Q that are wanted; one in twelve samples at most.

    Raises
    ------
    NotIdentifiable
        Fewer than 120 samples, a signal that does not move, or too few rows without a missing sample.
    """
    us, ys = ([np.asarray(r[name], dtype=float)[: _MOST // len(records)] for r in records] for name in (input, output))
    n = sum(map(len, ys))
    if n < _FEWEST:
        raise NotIdentifiable(f"{n} samples: a test of the plant needs at least {_FEWEST}")
    us, ys = _scaled(us, input), _scaled(ys, output)
    Q = max(1, min(reach, n // _SAMPLES_A_LAG))
    sums = _sums(us, ys, first_lag, Q)
    if sums.rows < 2 * len(sums.cross):
        raise NotIdentifiable(f"{sums.rows} complete rows: a test of the plant needs {2 * len(sums.cross)}")
    longest = OUTPUT_LAGS[-1]
    P = _output_lags(sums, longest)
    chosen = np.r_[0:P, len(sums.cross) - 1 : longest - 1 : -1]
    factor, explained = factored(sums.columns(chosen))
    theta = linalg.solve_triangular(factor, explained, lower=True, trans="T")
    alpha, b = theta[:P], theta[: P - 1 : -1]
    innovations = [_innovations(u, y, alpha, b, first_lag, max(longest, Q)) for u, y in zip(us, ys, strict=True)]
    energy = sum(float(np.nansum(e**2)) for e in innovations)
    variance = max(energy / max(sums.rows - len(chosen), 1), _RESOLUTION)
    leading = np.cumsum(explained[: P - 1 : -1] ** 2) / variance
    return LongAutoregression(
        alpha, b, leading, factor / np.sqrt(variance), first_lag, us, innovations, energy / sums.rows > _RESOLUTION
    )


def _scaled(parts: Sequence[FloatArray], name: str) -> list[FloatArray]:
    centred = [part - np.nanmean(part) if np.isfinite(part).any() else part for part in parts]
    power = float(np.nanmean(np.concatenate(centred) ** 2)) if any(np.isfinite(part).any() for part in centred) else 0.0
    if not power > 0:
        raise NotIdentifiable(f"channel {name!r}: does not move; nothing can be tested")
    return [part / np.sqrt(power) for part in centred]


def _sums(us: Sequence[FloatArray], ys: Sequence[FloatArray], first_lag: int, Q: int) -> RegressionSums:
    """Of outputs 1 … 30 lags back, then inputs `first_lag` … Q lags back, each record about its means."""
    orders = [lags + 1 - first_lag for lags in (OUTPUT_LAGS[-1], Q)]
    parts = []
    for u, y in zip(us, ys, strict=True):
        try:
            parts.append(regression_sums([y, u], y, max(orders), first_lag, orders=orders).centred())
        except NotIdentifiable:
            continue  # a record without a complete row adds nothing
    total = reduce(add, parts, RegressionSums.zero(sum(orders)))
    return total.columns(np.arange(1 - first_lag, sum(orders)))


def _output_lags(sums: RegressionSums, longest: int) -> int:
    """P of the smallest BIC."""
    inputs_first = np.r_[longest : len(sums.cross), 0:longest]
    _, explained = factored(sums.columns(inputs_first))
    left = sums.energy - np.cumsum(explained**2)[-longest - 1 :]
    return min(OUTPUT_LAGS, key=lambda P: sums.rows * float(np.log(max(float(left[P]), _RESOLUTION))) + P * np.log(sums.rows))


def factored(sums: RegressionSums) -> tuple[FloatArray, FloatArray]:
    """L of the Gram matrix, raised so little that columns which say the same have a factor, too, and L⁻¹ Φᵀy."""
    gram = sums.gram.copy()
    size = float(gram.trace()) / max(len(gram), 1)
    gram[np.diag_indices_from(gram)] += _RIDGE * (np.diag(gram) + max(size, 1.0))
    factor = linalg.cholesky(gram, lower=True)
    return factor, linalg.solve_triangular(factor, sums.cross, lower=True)


def _innovations(u: FloatArray, y: FloatArray, alpha: FloatArray, b: FloatArray, first_lag: int, reach: int) -> FloatArray:
    """e about its mean; NaN where the past is not whole."""
    n = len(y)
    e = np.convolve(y, np.r_[1.0, -alpha])[:n] - np.convolve(u, np.r_[np.zeros(first_lag), b])[:n]
    e[:reach] = np.nan
    return e - np.nanmean(e) if np.isfinite(e).any() else e
