"""How often a scanning statistic of pure noise crosses a threshold: the closed forms behind every chosen false-alarm rate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy import optimize, special

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput

SECONDS_A_DAY = 86400.0
_OVERLAP = 0.6  # crossings by several lengths at once, counted once: measured over 10⁷ samples at 10⁻³ … 10⁻⁵ a sample


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
            f"false alarms per day: {false_alarms_per_day!r}; must be positive and at most {most:.4g}, one in ten samples"
        )
    return rate


def overshoot_factor(x: npt.ArrayLike) -> FloatArray:
    """ν(x), Siegmund's correction for looking at a random walk only at its steps.

    ν(x) ≈ (2/x)(Φ(x/2) − ½) / ((x/2) Φ(x/2) + φ(x/2)), Siegmund and Yakir, The Statistics of Gene Mapping (2007), eq. (5.7).

    >>> round(float(overshoot_factor(1e-6)), 4)
    1.0
    """
    half = np.asarray(x, dtype=float) / 2.0
    return np.asarray((special.ndtr(half) - 0.5) / half / (half * special.ndtr(half) + _normal_density(half)))


def scan_rate(b: float, windows: Sequence[int]) -> float:
    """Crossings per sample of +b by any standardised moving sum of these lengths over independent standard normals.

    A moving sum over ℓ samples has the correlation 1 − k/ℓ, hence crosses at the rate φ(b) b ν(b √(2/ℓ))/ℓ
    (Siegmund and Venkatraman, 1995); the windows are added up, which overstates the rate a little because neighbouring
    lengths cross together.

    >>> bool(abs(scan_rate(4.0, [1]) / special.ndtr(-4.0) - 1) < 0.1)
    True
    """
    lengths = np.asarray(windows, dtype=float)
    return float(_normal_density(b) * b * np.sum(overshoot_factor(b * np.sqrt(2.0 / lengths)) / lengths))


def _normal_density(x: npt.ArrayLike) -> FloatArray:
    return np.asarray(np.exp(-np.square(x) / 2.0) / np.sqrt(2.0 * np.pi))


def scan_threshold(rate: float, scans: Sequence[tuple[int, Sequence[int]]]) -> float:
    """b such that all `scans` together, each (number of sides, window lengths), cross at `rate` per sample.

    The sum over windows about √2 apart overstates the joint rate; the factor that corrects it was measured once. A single
    window, on one side or two, crosses alone.
    """
    overlap = _OVERLAP if max(len(windows) for _, windows in scans) > 1 else 1.0

    def excess(b: float) -> float:
        scanned = sum(sides * scan_rate(b, windows) for sides, windows in scans)
        return float(np.log(overlap * scanned / rate))

    return float(optimize.brentq(excess, 1.0, 30.0)) if excess(1.0) > 0 else 1.0


def shiryaev_roberts_rate(level: float, step: float) -> float:
    """Alarms per sample of a two-sided Shiryaev–Roberts statistic for ±`step` standard deviations with threshold ln R = `level`.

    R(t) − t is a martingale while healthy, so the mean time until R passes e^level is e^level/ν(step), exact but for the mean
    overshoot (Pollak, Annals of Statistics 15, 1987); halved for two sides.

    >>> round(1.0 / shiryaev_roberts_rate(np.log(1000.0), 1e-6))
    500
    """
    return 2.0 * float(overshoot_factor(step)) * float(np.exp(-level))


def cusum_threshold(rate: float, reference: float) -> float:
    """h of a two-sided CUSUM of independent standard normals that alarms at `rate` per sample.

    Siegmund's approximation of the one-sided mean time between alarms,
    (e^{2kh′} − 2kh′ − 1)/(2k²) with h′ = h + 1.166, halved for two sides (Sequential Analysis, 1985, ch. 10).
    """
    return float(optimize.brentq(lambda h: _log_cusum_rate(h, reference) - np.log(rate), 1e-6, 1000.0))


def _log_cusum_rate(h: float, reference: float) -> float:
    exponent = 2.0 * reference * (h + 1.166)
    return float(np.log(4.0 * reference**2) - exponent - np.log1p(-(1.0 + exponent) * np.exp(-exponent)))
