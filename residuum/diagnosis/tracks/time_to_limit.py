"""When a value that follows a local trend will pass a limit, with what is uncertain in level, slope and their walk."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from residuum.array_types import FloatArray
from residuum.diagnosis.tracks.local_trend import LocalTrend

_DRAWS = 3000
_STEPS = 160
_HORIZON = 20.0
"""Longest time that is looked ahead, in lengths of the history."""


@dataclass(frozen=True)
class TimeToLimit:
    """Time from the last sample until the limit is passed.

    Attributes
    ----------
    limit : float
    median, low, high : float or None
        Quantiles; None where that quantile does not pass it within twenty times the history.
    confidence : float
        Probability between `low` and `high`.
    says : str
        `cannot say` with the reason, `passed`, or empty.
    """

    limit: float
    median: float | None
    low: float | None
    high: float | None
    confidence: float
    says: str


def time_to_limit(now: LocalTrend, limit: float, history: float, drifting: bool, confidence: float, seed: int) -> TimeToLimit:
    """Draw futures from the posterior of level, slope and walk, and take the quantiles of their first passage.

    The limit lies above or below the value of now; what drifts away from it, or does not drift, cannot be said.
    """
    mean, covariance = now.state
    above = limit >= mean[0]
    toward = mean[1] if above else -mean[1]
    beyond = abs(mean[0] - limit) < 0.5 * float(np.sqrt(max(covariance[0, 0], 0.0)))
    if beyond:
        return TimeToLimit(limit, 0.0, 0.0, 0.0, confidence, "the limit is reached")
    if not drifting:
        return TimeToLimit(limit, None, None, None, confidence, "cannot say: there is no trend")
    if toward <= 0:
        return TimeToLimit(limit, None, None, None, confidence, "cannot say: the value drifts away from the limit")
    passage = _passages(now, limit, 1.0 if above else -1.0, _HORIZON * history, np.random.default_rng(seed))
    tail = (1.0 - confidence) / 2.0
    low, median, high = (_finite(float(np.quantile(passage, q, method="lower"))) for q in (tail, 0.5, 1.0 - tail))
    return TimeToLimit(limit, median, low, high, confidence, "")


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _passages(now: LocalTrend, limit: float, sign: float, horizon: float, rng: np.random.Generator) -> FloatArray:
    """First passage of each drawn future; infinite where there is none."""
    chosen = rng.choice(len(now.weight), _DRAWS, p=now.weight)
    P = now.covariance[chosen][:, :2, :2]
    root = np.linalg.cholesky(P + 1e-12 * np.maximum(np.einsum("fii->fi", P), 1e-300)[:, :, None] * np.eye(2))
    state = now.mean[chosen][:, :2] + np.einsum("fij,fj->fi", root, rng.standard_normal((_DRAWS, 2)))
    left, slope = sign * (limit - state[:, 0]), sign * state[:, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        straight = np.where(left <= 0.0, 0.0, np.where(slope > 0.0, left / slope, np.inf))
    walking = (now.level_walk[chosen] > 0.0) | (now.slope_walk[chosen] > 0.0)
    passage = straight.copy()
    middle = np.median(straight[np.isfinite(straight)]) if np.isfinite(straight).any() else horizon
    passage[walking] = _walked(
        left[walking], slope[walking], now.level_walk[chosen][walking], now.slope_walk[chosen][walking], middle, horizon, rng
    )
    return np.where(passage <= horizon, passage, np.inf)


def _walked(
    left: FloatArray,
    slope: FloatArray,
    q_level: FloatArray,
    q_slope: FloatArray,
    middle: float,
    horizon: float,
    rng: np.random.Generator,
) -> FloatArray:
    """Passages of futures whose level or slope walks, step by step: fine up to twice the middle, then ever coarser.

    A level that walks is given its deviation at each time by one draw: an excursion that comes back is no wear.
    """
    excursion = q_level * rng.standard_normal(len(left))
    fine = np.linspace(0.0, min(2.0 * middle, horizon), _STEPS)
    times = np.concatenate([fine, np.geomspace(fine[-1] * 1.05, max(horizon, fine[-1] * 1.1), 40)])
    passage = np.full(len(left), np.inf)
    passage[left <= 0.0] = 0.0
    b, gap = slope.copy(), left.copy()
    for begin, end in pairwise(times.tolist()):
        h = end - begin
        before = gap.copy()
        turn = q_slope * np.sqrt(h) * rng.standard_normal(len(gap))
        gap = gap - (b + 0.5 * turn) * h - excursion * (np.sqrt(end) - np.sqrt(begin))
        b = b + turn
        passed = np.isinf(passage) & (gap <= 0.0)
        passage[passed] = begin + h * before[passed] / np.maximum(before[passed] - gap[passed], 1e-300)
    return passage
