"""How often a scanning statistic of pure noise crosses a threshold: the closed forms behind every
chosen false-alarm rate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import optimize, special, stats

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput
from residuum.kept_loops import njit

# Two-sided cumulative sum (CUSUM) of a standardised signal.


class CusumOutput(NamedTuple):
    """Per sample: the larger of the two sums, the alarms (+1 up, −1 down, 0 none) and the samples
    since that sum was zero.
    """

    statistic: FloatArray
    alarm: npt.NDArray[np.int64]
    since: npt.NDArray[np.int64]


def cusum(
    x: npt.ArrayLike, valid: npt.ArrayLike, reference: float, threshold: float
) -> CusumOutput:
    """g⁺ = max(0, g⁺ + x − k), g⁻ = max(0, g⁻ − x − k); alarm when one exceeds h, after which both
    start at zero.

    Page (1954); optimal for a step of 2 k. Its false-alarm rate for independent standard normals is
    that of `cusum_threshold`; correlated x raise it, and a lasting model error larger than k makes
    it alarm for certain.

    Parameters
    ----------
    x, valid : arrays, shape (n,)
        Standardised signal; where `valid` is False both sums are zero.
    reference, threshold : float
        k and h [standard deviations].

    Examples
    --------
    >>> output = cusum([0.0] * 5 + [2.0] * 5, [True] * 10, 0.5, 4.0)
    >>> int(np.argmax(output.alarm)), int(output.since[np.argmax(output.alarm)])
    (7, 3)
    """
    x = np.ascontiguousarray(x, dtype=float)
    n = len(x)
    output = CusumOutput(np.zeros(n), np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64))
    _cusum(x, np.ascontiguousarray(valid, dtype=bool), float(reference), float(threshold), *output)
    return output


@njit()
def _cusum(x, valid, reference, threshold, statistic, alarm, since):  # type: ignore[no-untyped-def]
    up = down = 0.0
    risen = fallen = 0
    for t in range(len(x)):
        if not valid[t]:
            up = down = 0.0
            risen = fallen = 0
            continue
        up, down = max(0.0, up + x[t] - reference), max(0.0, down - x[t] - reference)
        risen = risen + 1 if up > 0.0 else 0
        fallen = fallen + 1 if down > 0.0 else 0
        statistic[t] = max(up, down)
        since[t] = risen if up >= down else fallen
        if statistic[t] > threshold:
            alarm[t] = 1 if up >= down else -1
            up = down = 0.0
            risen = fallen = 0


SECONDS_A_DAY = 86400.0
# crossings by several lengths at once, counted once: measured over 10⁷ samples at 10⁻³ … 10⁻⁵ a
# sample
_OVERLAP = 0.6


def alarms_per_sample(false_alarms_per_day: float, sample_time: float) -> float:
    """The rate per sample that a number of false alarms a day means.

    Raises
    ------
    BadInput
        Not a positive number, or more than one alarm in ten samples.
    """
    rate = false_alarms_per_day * sample_time / SECONDS_A_DAY
    if not (np.isfinite(rate) and 0 < rate <= 0.1):
        most = 0.1 * SECONDS_A_DAY / sample_time
        raise BadInput(
            f"false alarms per day: {false_alarms_per_day!r}; must be positive and at most"
            f" {most:.4g}, one in ten samples"
        )
    return rate


def overshoot_factor(x: npt.ArrayLike) -> FloatArray:
    """ν(x), Siegmund's correction for looking at a random walk only at its steps.

    ν(x) ≈ (2/x)(Φ(x/2) − ½) / ((x/2) Φ(x/2) + φ(x/2)), Siegmund and Yakir, The Statistics of Gene
    Mapping (2007), eq. (5.7).

    >>> round(float(overshoot_factor(1e-6)), 4)
    1.0
    """
    half = np.asarray(x, dtype=float) / 2.0
    return np.asarray(
        (special.ndtr(half) - 0.5) / half / (half * special.ndtr(half) + _normal_density(half))
    )


def scan_rate(b: float, windows: Sequence[int]) -> float:
    """Crossings per sample of +b by any standardised moving sum of these lengths over independent
    standard normals.

    A moving sum over ℓ samples has the correlation 1 − k/ℓ, hence crosses at the rate φ(b) b ν(b
    √(2/ℓ))/ℓ (Siegmund and Venkatraman, 1995); the windows are added up, which overstates the rate
    a little because neighbouring lengths cross together.

    >>> bool(abs(scan_rate(4.0, [1]) / special.ndtr(-4.0) - 1) < 0.1)
    True
    """
    lengths = np.asarray(windows, dtype=float)
    return float(
        _normal_density(b) * b * np.sum(overshoot_factor(b * np.sqrt(2.0 / lengths)) / lengths)
    )


def _normal_density(x: npt.ArrayLike) -> FloatArray:
    return np.asarray(np.exp(-np.square(x) / 2.0) / np.sqrt(2.0 * np.pi))


def scan_threshold(rate: float, scans: Sequence[tuple[int, Sequence[int]]]) -> float:
    """b such that all `scans` together, each (number of sides, window lengths), cross at `rate` per
    sample.

    The sum over windows about √2 apart overstates the joint rate; the factor that corrects it was
    measured once. A single window, on one side or two, crosses alone.
    """
    overlap = _OVERLAP if max(len(windows) for _, windows in scans) > 1 else 1.0

    def excess(b: float) -> float:
        scanned = sum(sides * scan_rate(b, windows) for sides, windows in scans)
        return float(np.log(overlap * scanned / rate))

    return float(optimize.brentq(excess, 1.0, 30.0)) if excess(1.0) > 0 else 1.0


def shiryaev_roberts_rate(level: float, step: float) -> float:
    """Alarms per sample of a two-sided Shiryaev–Roberts statistic for ±`step` standard deviations
    with threshold ln R = `level`.

    R(t) − t is a martingale while healthy, so the mean time until R passes e^level is
    e^level/ν(step), exact but for the mean overshoot (Pollak, Annals of Statistics 15, 1987);
    halved for two sides.

    >>> round(1.0 / shiryaev_roberts_rate(np.log(1000.0), 1e-6))
    500
    """
    return 2.0 * float(overshoot_factor(step)) * float(np.exp(-level))


def cusum_threshold(rate: float, reference: float) -> float:
    """h of a two-sided CUSUM of independent standard normals that alarms at `rate` per sample.

    Siegmund's approximation of the one-sided mean time between alarms, (e^{2kh′} − 2kh′ − 1)/(2k²)
    with h′ = h + 1.166, halved for two sides (Sequential Analysis, 1985, ch. 10).
    """
    return float(
        optimize.brentq(lambda h: _log_cusum_rate(h, reference) - np.log(rate), 1e-6, 1000.0)
    )


def _log_cusum_rate(h: float, reference: float) -> float:
    exponent = 2.0 * reference * (h + 1.166)
    return float(
        np.log(4.0 * reference**2) - exponent - np.log1p(-(1.0 + exponent) * np.exp(-exponent))
    )


# What healthy records teach beyond the model: bounds, peaks of each statistic, and whether the
# model itself falls short.

BLOCK = 128  # samples a peak is taken from; far longer than a whitened residual remembers
FEWEST_BLOCKS = 10
_CONFIDENCE = 0.95
_UPPER = 0.9  # quantile above which peaks are asked how often they come alone


@dataclass(frozen=True)
class CalibratedThreshold:
    """A threshold learnt from healthy peaks, and what it promises.

    `guaranteed` is True when, with 95 % confidence over healthy records of this length, the true
    rate is at most twice the chosen one, whatever the distribution; otherwise the tail was
    extrapolated. `days_needed` is the healthy data that a guarantee at this rate takes.
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

    With p = 128 · rate the chance a block may exceed it, the k-th largest of J healthy peaks
    exceeds its own quantile with the binomial law of order statistics, so it is a guarantee (≤ 2p
    with 95 % confidence) as soon as P(Binomial(J, 2p) ≤ k − 1) ≤ 5 %: 3/(2p) blocks are needed at
    least. Neighbouring blocks may depend on each other; one block is the span that is assumed to
    forget. With less data the squared peaks, which have an exponential tail for Gaussian scores of
    any evaluation, are extrapolated by a generalised Pareto law of non-negative shape (a bounded
    tail is never assumed), and nothing is promised.

    Of neighbouring peaks only the largest counts: a statistic that stands out for longer than a
    block, or at the seam of two, is one alarm.

    Raises
    ------
    BadInput
        Fewer than 10 blocks of healthy samples.
    """
    if len(peaks) < FEWEST_BLOCKS:
        raise BadInput(
            f"calibrated threshold: {len(peaks)} blocks of {BLOCK} healthy samples; at least"
            f" {FEWEST_BLOCKS} are needed"
        )
    p, n = min(BLOCK * rate, 0.5), len(peaks)
    days = n * BLOCK * sample_time / SECONDS_A_DAY
    needed = (
        float(np.log(1 - _CONFIDENCE) / np.log1p(-min(2 * p, 0.99)))
        * BLOCK
        * sample_time
        / SECONDS_A_DAY
    )
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
    return CalibratedThreshold(
        float(np.sqrt(_extrapolated(np.sort(peaks**2)[::-1], p / share))), False, days, needed
    )


def _largest_of_neighbours(peaks: FloatArray) -> FloatArray:
    """The peaks, those smaller than one beside them set to zero."""
    beside = np.concatenate([[-np.inf], peaks, [-np.inf]])
    return np.where((peaks >= beside[:-2]) & (peaks > beside[2:]), peaks, 0.0)


def _extrapolated(squares: FloatArray, p: float) -> float:
    """Quantile of exceedance probability p of a generalised Pareto tail over the upper third of the
    peaks.
    """
    n = len(squares)
    k = max(FEWEST_BLOCKS // 2, n // 3)
    base, excess = squares[k], squares[:k] - squares[k]
    mean = float(np.mean(excess))
    if mean == 0.0:
        return float(base)
    # Hosking and Wallis' (1987) moment estimate of the shape, kept between an exponential and a
    # heavy tail.
    shape = float(np.clip(0.5 * (1.0 - mean**2 / np.var(excess)), 0.0, 0.5)) if n >= 100 else 0.0
    ratio = k / (n * p)
    if shape < 1e-6:
        return float(base + mean * np.log(ratio))
    scale = mean * (1.0 - shape)
    return float(base + scale / shape * (ratio**shape - 1.0))
