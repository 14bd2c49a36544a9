"""Trend of an indicator over weeks: since when does it change, how fast, and when will it reach its limit?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.stats import t as student

from residuum.identification.errors import BadInput, NotIdentifiable

Array = npt.NDArray[Any]
_FEWEST = 6
_DRAWS = 4000


@dataclass(frozen=True)
class Trend:
    """The straight line that holds now.

    Attributes
    ----------
    since : float
        Time of the last change of level or slope (or of maintenance, or the first sample).
    slope, slope_low, slope_high : float
        Per unit of time, with its two-sided confidence band.
    level : float
        The line at the last sample.
    rising : bool
        Whether the band of the slope lies above 0.
    scatter : float
        Standard deviation of one sample about the line.
    remaining, remaining_low, remaining_high : float or None
        Time from the last sample until the line crosses the limit: median and quantiles of the posterior; None where the
        quantile never crosses; 0 when it has.
    """

    since: float
    slope: float
    slope_low: float
    slope_high: float
    level: float
    rising: bool
    scatter: float
    remaining: float | None
    remaining_low: float | None
    remaining_high: float | None


def trend(
    time: npt.ArrayLike,
    value: npt.ArrayLike,
    limit: float,
    *,
    maintenance: Sequence[float] = (),
    confidence: float = 0.9,
    seed: int = 0,
) -> Trend:
    """Piecewise-linear trend of an indicator.

    Only samples after the last maintenance count. The last change point is the split that lowers the Bayesian information
    criterion of one line to that of two (with a continuous or a broken joint) the most, sought again in the later part
    until no split pays. The slope then has Student's band, and the crossing of the limit the distribution that the
    joint posterior of level and slope gives it (drawn with a seed). Missing values are left out.

    It extrapolates a straight line: for damage that accelerates it is too late by design, so look at its lower quantile
    and repeat it with every sample. With a false-alarm probability of (1 − confidence)/2 a flat indicator is called rising.

    Raises
    ------
    BadInput
        Unequal lengths or times that do not rise.
    NotIdentifiable
        Fewer than 6 samples since the last maintenance.

    Examples
    --------
    >>> t = np.arange(60.0)
    >>> y = 1 + 0.05 * np.maximum(t - 30, 0) + 0.02 * np.random.default_rng(0).standard_normal(60)
    >>> found = trend(t, y, limit=4.0)
    >>> found.rising, 25 < found.since < 35, 28 < found.remaining < 34
    (True, True, True)
    """
    t, y = np.asarray(time, dtype=float), np.asarray(value, dtype=float)
    if t.shape != y.shape or t.ndim != 1 or not (np.diff(t) > 0).all():
        raise BadInput(f"trend: times {t.shape} and values {y.shape} must be equal vectors, times rising")
    kept = ~np.isnan(y) & (t >= max(maintenance, default=-np.inf))
    t, y = t[kept], y[kept]
    if t.shape[0] < _FEWEST:
        raise NotIdentifiable(f"trend: {t.shape[0]} samples since the last maintenance; at least {_FEWEST} are needed")
    first = _last_change(t, y)
    return _line(t[first:], y[first:], limit, confidence, seed)


def _last_change(t: Array, y: Array) -> int:
    start = 0
    while (split := _best_split(t[start:], y[start:])) is not None:
        start += split
    return start


def _best_split(t: Array, y: Array) -> int | None:
    """First sample of the later of two lines, when two are worth their three more parameters (two and the place)."""
    n = t.shape[0]
    if n < 2 * _FEWEST:
        return None
    candidates = range(_FEWEST, n - _FEWEST + 1)
    squares = [_residual_square(t[:k], y[:k]) + _residual_square(t[k:], y[k:]) for k in candidates]
    best = int(np.argmin(squares))
    tiny = 1e-12 * max(float(np.sum(y * y)), 1e-300)
    gain = n * np.log((_residual_square(t, y) + tiny) / (squares[best] + tiny))
    return candidates[best] if gain > 2 * 3 * np.log(n) else None  # twice BIC's price: the place was searched for


def _residual_square(t: Array, y: Array) -> float:
    s = t - t.mean()
    r = y - y.mean()
    spread = float(s @ s)
    return float(r @ r - (s @ r) ** 2 / spread) if spread > 0 else float(r @ r)


def _line(t: Array, y: Array, limit: float, confidence: float, seed: int) -> Trend:
    n = t.shape[0]
    s = t - t.mean()
    spread = float(s @ s)
    slope = float(s @ (y - y.mean())) / spread
    scatter = float(np.sqrt(max(_residual_square(t, y), 0.0) / (n - 2)))
    reach = float(student.isf((1 - confidence) / 2, n - 2)) * scatter / np.sqrt(spread)
    rng = np.random.default_rng(seed)
    sigma = scatter * np.sqrt(
        (n - 2) / rng.chisquare(n - 2, _DRAWS)
    )  # one draw of σ serves level and slope: their joint posterior
    draws = rng.standard_normal((2, _DRAWS)) * sigma
    slopes = slope + draws[0] / np.sqrt(spread)
    levels = y.mean() + slope * s[-1] + draws[1] / np.sqrt(n) + (slopes - slope) * s[-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        wait = np.where(levels >= limit, 0.0, np.where(slopes > 0, (limit - levels) / slopes, np.inf))
    tail = (1 - confidence) / 2
    low, middle, high = (float(np.quantile(wait, q, method="lower")) for q in (tail, 0.5, 1 - tail))
    return Trend(
        float(t[0]),
        slope,
        slope - reach,
        slope + reach,
        float(y.mean() + slope * s[-1]),
        bool(slope - reach > 0),
        scatter,
        *(value if np.isfinite(value) else None for value in (middle, low, high)),
    )
