"""What healthy records teach beyond the model: bounds, peaks of each statistic, and whether the model itself falls short."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from residuum.array_types import FloatArray
from residuum.diagnosis.thresholds.false_alarm_rate import SECONDS_A_DAY
from residuum.identification.errors import BadInput

BLOCK = 128  # samples a peak is taken from; far longer than a whitened residual remembers
FEWEST_BLOCKS = 10
_CONFIDENCE = 0.95
_UPPER = 0.9  # quantile above which peaks are asked how often they come alone


@dataclass(frozen=True)
class CalibratedThreshold:
    """A threshold learnt from healthy peaks, and what it promises.

    `guaranteed` is True when, with 95 % confidence over healthy records of this length, the true rate is at most twice the
    chosen one, whatever the distribution; otherwise the tail was extrapolated. `days_needed` is the healthy data that a
    guarantee at this rate takes.
    """

    value: float
    guaranteed: bool
    days: float
    days_needed: float


def block_peaks(statistic: Sequence[FloatArray], valid: Sequence[np.ndarray]) -> FloatArray:
    """Largest value of a healthy statistic in each block of 128 valid samples, shape (blocks,)."""
    peaks = [
        np.abs(series[mask][: len(series[mask]) // BLOCK * BLOCK]).reshape(-1, BLOCK).max(axis=1)
        for series, mask in zip(statistic, valid, strict=True)
    ]
    return np.concatenate(peaks) if peaks else np.zeros(0)


def calibrated_threshold(peaks: FloatArray, rate: float, sample_time: float) -> CalibratedThreshold:
    """Threshold that healthy blocks exceed at `rate` per sample.

    With p = 128 · rate the chance a block may exceed it, the k-th largest of J healthy peaks exceeds its own quantile
    with the binomial law of order statistics, so it is a guarantee (≤ 2p with 95 % confidence) as soon as
    P(Binomial(J, 2p) ≤ k − 1) ≤ 5 %: 3/(2p) blocks are needed at least. Neighbouring blocks may depend on each other;
    one block is the span that is assumed to forget. With less data the squared peaks, which have an exponential tail for
    Gaussian scores of any evaluation, are extrapolated by a generalised Pareto law of non-negative shape (a bounded tail
    is never assumed), and nothing is promised.

    Of neighbouring peaks only the largest counts: a statistic that stands out for longer than a block, or at the seam of
    two, is one alarm.

    Raises
    ------
    BadInput
        Fewer than 10 blocks of healthy samples.
    """
    if len(peaks) < FEWEST_BLOCKS:
        raise BadInput(
            f"calibrated threshold: {len(peaks)} blocks of {BLOCK} healthy samples; at least {FEWEST_BLOCKS} are needed"
        )
    p, n = min(BLOCK * rate, 0.5), len(peaks)
    days = n * BLOCK * sample_time / SECONDS_A_DAY
    needed = float(np.log(1 - _CONFIDENCE) / np.log1p(-min(2 * p, 0.99))) * BLOCK * sample_time / SECONDS_A_DAY
    alone = _largest_of_neighbours(peaks)
    descending = np.sort(alone)[::-1]
    ranks = np.arange(1, n + 1)
    allowed = np.flatnonzero(stats.binom.cdf(ranks - 1, n, min(2 * p, 0.99)) <= 1 - _CONFIDENCE)
    if len(allowed):
        # The rank that is right on average, unless it would not keep the promise.
        k = min(int(allowed[-1]) + 1, max(1, int(np.floor(p * (n + 1)))))
        return CalibratedThreshold(float(descending[k - 1]), True, days, needed)
    upper = peaks >= np.quantile(peaks, _UPPER)
    share = float(np.mean(alone[upper] > 0.0))
    return CalibratedThreshold(float(np.sqrt(_extrapolated(np.sort(peaks**2)[::-1], p / share))), False, days, needed)


def _largest_of_neighbours(peaks: FloatArray) -> FloatArray:
    """The peaks, those smaller than one beside them set to zero."""
    beside = np.concatenate([[-np.inf], peaks, [-np.inf]])
    return np.where((peaks >= beside[:-2]) & (peaks > beside[2:]), peaks, 0.0)


def _extrapolated(squares: FloatArray, p: float) -> float:
    """Quantile of exceedance probability p of a generalised Pareto tail over the upper third of the peaks."""
    n = len(squares)
    k = max(FEWEST_BLOCKS // 2, n // 3)
    base, excess = squares[k], squares[:k] - squares[k]
    mean = float(np.mean(excess))
    if mean == 0.0:
        return float(base)
    # Hosking and Wallis' (1987) moment estimate of the shape, kept between an exponential and a heavy tail.
    shape = float(np.clip(0.5 * (1.0 - mean**2 / np.var(excess)), 0.0, 0.5)) if n >= 100 else 0.0
    ratio = k / (n * p)
    if shape < 1e-6:
        return float(base + mean * np.log(ratio))
    scale = mean * (1.0 - shape)
    return float(base + scale / shape * (ratio**shape - 1.0))
