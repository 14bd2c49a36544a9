"""A long autoregression with input, the common ground of the tests: it needs no knowledge of orders, dead time or feedback.

A(q) y(t) = Σ_{j=0 or 1}^{Q} b_j u(t − j) + c + e(t),   A(q) = 1 + a₁ q⁻¹ + … + a_P q⁻ᴾ

by least squares, P by BIC. With lags enough e is white, and the estimates are consistent for open and closed loops alike (direct
method: Ljung, System Identification (1999), 13.4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.identification.blas_threads import one_thread_if_small
from residuum.identification.errors import NotIdentifiable
from residuum.identification.record import Record

FloatArray = npt.NDArray[np.float64]
OUTPUT_LAGS = (2, 4, 8, 16, 30)
"""Candidates for P."""
SHORT_REACH, LONG_REACH = 120, 600
"""Input lags Q of a first look, and at most."""
_SAMPLES_A_LAG = 12
_FEWEST, _MOST = 120, 40_000
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
    covariance : array, shape (P + Q + 1 − first_lag,) squared
        Of both, the output's first.
    first_lag : int
        0 where the input may act within its own sample, else 1.
    inputs, innovations : list of array
        u and e of each record, shape (n,); NaN where unknown.
    resolved : bool
        Whether e is more than rounding.
    """

    output_weights: FloatArray
    input_weights: FloatArray
    covariance: FloatArray
    first_lag: int
    inputs: list[FloatArray]
    innovations: list[FloatArray]
    resolved: bool

    @property
    def input_covariance(self) -> FloatArray:
        """Covariance of `input_weights`."""
        first = len(self.output_weights)
        return self.covariance[first:, first:]


@one_thread_if_small(SHORT_REACH)
def long_autoregression(
    records: Sequence[Record], input: str, output: str, *, first_lag: int = 1, reach: int = SHORT_REACH
) -> LongAutoregression:
    """Estimate it over all records, each with a level of its own; at most their first 40 000 samples count.

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
    longest = OUTPUT_LAGS[-1]
    parts = [_rows(u, y, longest, first_lag, Q) for u, y in zip(us, ys, strict=True)]
    X, t = np.vstack([part[0] for part in parts]), np.concatenate([part[1] for part in parts])
    if len(t) < 2 * X.shape[1]:
        raise NotIdentifiable(f"{len(t)} complete rows: a test of the plant needs {2 * X.shape[1]}")
    gram, cross = X.T @ X, X.T @ t
    fits = {P: _solved(gram, cross, t, np.r_[0:P, longest : X.shape[1]], X) for P in OUTPUT_LAGS}
    P = min(fits, key=lambda p: len(t) * float(np.log(max(float(fits[p][2] @ fits[p][2]), _RESOLUTION))) + p * np.log(len(t)))
    theta, covariance, e = fits[P]
    innovations = _in_place(e, [len(y) for y in ys], [part[2] for part in parts])
    resolved = float(e @ e) / len(t) > _RESOLUTION
    return LongAutoregression(theta[:P], theta[P:], covariance, first_lag, us, innovations, resolved)


def _scaled(parts: Sequence[FloatArray], name: str) -> list[FloatArray]:
    centred = [part - np.nanmean(part) if np.isfinite(part).any() else part for part in parts]
    power = float(np.nanmean(np.concatenate(centred) ** 2)) if any(np.isfinite(part).any() for part in centred) else 0.0
    if not power > 0:
        raise NotIdentifiable(f"channel {name!r}: does not move; nothing can be tested")
    return [part / np.sqrt(power) for part in centred]


def _rows(u: FloatArray, y: FloatArray, P: int, first_lag: int, Q: int) -> tuple[FloatArray, FloatArray, npt.NDArray[np.int_]]:
    """Regressors and output of one record about their means, rows with a missing sample left out, and where the rows are."""
    m = max(P, Q)
    if len(y) <= m + 1:
        return np.zeros((0, P + Q + 1 - first_lag)), np.zeros(0), np.zeros(0, dtype=int)
    past = np.lib.stride_tricks.sliding_window_view(y, m + 1)[:, ::-1]
    driven = np.lib.stride_tricks.sliding_window_view(u, m + 1)[:, ::-1]
    X, t = np.hstack([past[:, 1 : P + 1], driven[:, first_lag : Q + 1]]), y[m:]
    X, t, known = complete_rows(X, t)
    return X, t, m + known


def complete_rows(X: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray, npt.NDArray[np.intp]]:
    """Regressors and target about their means, rows with a missing sample left out, and which rows are left."""
    known = np.flatnonzero(np.isfinite(X).all(axis=1) & np.isfinite(t))
    X, t = X[known], t[known]
    return (X - X.mean(axis=0), t - t.mean(), known) if len(t) else (X, t, known)


def ridged(gram: FloatArray) -> FloatArray:
    """A Gram matrix that can be inverted where columns say the same."""
    found = gram.copy()
    found[np.diag_indices_from(found)] *= 1 + _RIDGE
    found[np.diag_indices_from(found)] += _RIDGE
    return found


def _solved(
    gram: FloatArray, cross: FloatArray, t: FloatArray, columns: npt.NDArray[np.int_], X: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    inverse = np.asarray(np.linalg.inv(ridged(gram[np.ix_(columns, columns)])), dtype=float)
    theta = inverse @ cross[columns]
    e = t - X[:, columns] @ theta
    variance = max(float(e @ e) / max(len(t) - len(columns), 1), _RESOLUTION)
    return theta, variance * inverse, e


def _in_place(e: FloatArray, lengths: Sequence[int], places: Sequence[npt.NDArray[np.int_]]) -> list[FloatArray]:
    found, first = [], 0
    for n, at in zip(lengths, places, strict=True):
        whole = np.full(n, np.nan)
        whole[at] = e[first : first + len(at)]
        first += len(at)
        found.append(whole)
    return found
