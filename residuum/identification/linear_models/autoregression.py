"""Autoregressive model of a noise, to whiten signals with: A(q) v = e, order by BIC."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import scipy

from residuum.array_types import FloatArray
from residuum.identification.errors import NotIdentifiable


def autocovariance(values: npt.ArrayLike, lags: int) -> FloatArray:
    """Biased sample autocovariance R(0) … R(lags) about the mean, shape (lags + 1,); missing
    samples are skipped.

    A missing sample takes part in no product; each lag is scaled by its own number of pairs, times
    (n − lag)/n.
    """
    values = np.asarray(values, dtype=float)
    known = ~np.isnan(values)
    if known.sum() <= lags:
        raise NotIdentifiable(
            f"{int(known.sum())} samples: an autocovariance up to lag {lags} needs more"
        )
    deviation = np.where(known, values - np.mean(values[known]), 0.0)
    size = scipy.fft.next_fast_len(len(values) + lags, real=True)
    products = scipy.fft.irfft(np.abs(scipy.fft.rfft(deviation, size)) ** 2, size)[: lags + 1]
    if known.all():
        return np.asarray(products / len(values))
    pairs = np.round(
        scipy.fft.irfft(np.abs(scipy.fft.rfft(known.astype(float), size)) ** 2, size)[: lags + 1]
    )
    taper = 1 - np.arange(lags + 1) / len(values)
    return np.asarray(products / np.maximum(pairs, 1.0) * taper)


def fit_autoregression(
    values: npt.ArrayLike, highest: int | None = None
) -> tuple[FloatArray, float]:
    """A = [1, a₁, …, a_p] and the variance of e, by Levinson's recursion; p ≤ `highest` by BIC.

    A is stable (all reflection coefficients below 1) also when samples are missing.

    >>> v = scipy.signal.lfilter([1.0], [1.0, -0.8], np.random.default_rng(0).standard_normal(2000))
    >>> fit_autoregression(v)[0].round(1).tolist()
    [1.0, -0.8]
    """
    values = np.asarray(values, dtype=float)
    n = int(np.count_nonzero(~np.isnan(values)))
    highest = min(int(10 * math.log10(max(n, 2))), n // 4) if highest is None else highest
    covariance = autocovariance(values, highest)
    if not covariance[0] > 0:
        raise NotIdentifiable("the residual is constant: it has no noise model")
    A, variance = np.ones(1), float(covariance[0])
    best, criterion = (A, variance), n * math.log(variance)
    for order in range(1, highest + 1):
        reflection = -float(A @ covariance[order:0:-1]) / variance
        if not abs(reflection) < 1:
            break
        A = np.append(A, 0.0) + reflection * np.append(A, 0.0)[::-1]
        variance *= 1 - reflection**2
        if variance <= 1e-14 * covariance[0]:
            break
        value = n * math.log(variance) + order * math.log(n)
        if value < criterion:
            best, criterion = (A, variance), value
    return best


def whitened(values: npt.ArrayLike, A: FloatArray) -> FloatArray:
    """A(q) applied to `values`, shape (n,): NaN for the first samples and wherever a missing sample
    is touched.
    """
    values = np.asarray(values, dtype=float)
    filtered = scipy.signal.lfilter(A, [1.0], np.where(np.isnan(values), 0.0, values))
    touched = scipy.signal.lfilter(np.ones(len(A)), [1.0], np.isnan(values).astype(float)) > 0.5
    filtered[touched] = np.nan
    filtered[: len(A) - 1] = np.nan
    return np.asarray(filtered)
