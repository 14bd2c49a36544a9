"""What a machine's values do over many windows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput, NotIdentifiable

# A value over irregular times as a local random walk: level and slope, with changes at known
# times and covariates.
# y_k = l(t_k) + xᵀ_k β + e_k, e_k ~ N(0, s_k² + σ²) dl = b dt + q_l dw₁, db = q_b dw₂
# with the exact covariance of the walk over any pause h (Q = q_l² [h 0; 0 0] + q_b² [h³/3 h²/2;
# h²/2 h]). At a change the level's or the slope's variance is opened. σ, q_l and q_b are not
# known: many filters run side by side, one a triple, and each is weighed by its marginal
# likelihood, so that bands hold what is uncertain in them too.
# Reference: A. C. Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, 1989,
# chapters 2.3 and 3.

_OWN_SCATTER = np.geomspace(0.3, 2.2, 9)
"""σ, in units of the scatter between neighbours."""
_LEVEL_WALK = (0.0, 0.3, 1.0)
"""q_l √(mean pause), in units of the same."""
_SLOPE_WALK = (0.0, 0.003, 0.02)
"""q_b (mean pause)^1.5, in units of the same."""
_WALK_IS_RARE = (0.25, 0.05)
"""Prior weight of each step up in the size of a level's and of a slope's walk."""
_FEW = ((0.4, 0.7, 1.0, 1.5), (0.0, 0.3), (0.0,))
"""σ, q_l and q_b of the filters that places of changes are sought with."""
_OPEN = 10.0
"""Standard deviation of what is opened (level, and level over the record's length), in units of the
values' span.
"""


@dataclass(frozen=True, eq=False)
class Samples:
    """A value as windows tell it.

    Attributes
    ----------
    t, y, std : array, shape (n,)
        Times (rising), values and their standard deviations.
    x : array, shape (n, covariates)
        What the value moves with, centred.
    """

    t: FloatArray
    y: FloatArray
    std: FloatArray
    x: FloatArray

    def __len__(self) -> int:
        return len(self.t)


@dataclass(frozen=True)
class Change:
    """At sample `at` the level (`level`), the slope (`slope`) or both (`renewal`) are opened: what
    was mended wears anew.
    """

    at: int
    kind: str


@dataclass(frozen=True, eq=False)
class LocalTrend:
    """Where the value stands at the last sample.

    Attributes
    ----------
    log_likelihood : float
        Marginal, over all filters.
    weight : array, shape (filters,)
    mean : array, shape (filters, 2 + covariates)
        Level, slope, β.
    covariance : array, shape (filters, 2 + covariates, 2 + covariates)
    level_walk, slope_walk : array, shape (filters,)
        q_l and q_b of each filter.
    """

    log_likelihood: float
    weight: FloatArray
    mean: FloatArray
    covariance: FloatArray
    level_walk: FloatArray
    slope_walk: FloatArray

    @property
    def state(self) -> tuple[FloatArray, FloatArray]:
        """Mean and covariance of level, slope and β over all filters."""
        mean = self.weight @ self.mean
        away = self.mean - mean
        return mean, np.einsum(
            "f,fij->ij", self.weight, self.covariance + away[:, :, None] * away[:, None, :]
        )


def neighbours_scatter(y: FloatArray) -> float:
    """Standard deviation of one value, from differences of neighbours (what moves slowly hardly
    counts).
    """
    step = np.abs(np.diff(y))
    return float(max(np.median(step) / 0.9539, 1e-9 * max(float(np.ptp(y)), 1e-300), 1e-300))


def local_trend(
    samples: Samples,
    alternatives: Sequence[Sequence[Change]],
) -> LocalTrend:
    """Filter a value to its last sample; alternative lists of changes are weighed by their
    likelihood.

    Parameters
    ----------
    samples : Samples
    alternatives : sequence of sequences of Change
    """
    trends = side_by_side(samples, alternatives)
    likely = np.array([trend.log_likelihood for trend in trends])
    share = np.exp(likely - likely.max())
    share /= share.sum()
    names = ("mean", "covariance", "level_walk", "slope_walk")
    joined = {name: np.concatenate([getattr(trend, name) for trend in trends]) for name in names}
    weight = np.concatenate(
        [part * trend.weight for part, trend in zip(share, trends, strict=True)]
    )
    return LocalTrend(
        float(likely.max() + np.log(np.mean(np.exp(likely - likely.max())))), weight, **joined
    )


def likelihoods(
    samples: Samples,
    alternatives: Sequence[Sequence[Change]],
) -> FloatArray:
    """Marginal log-likelihood of several lists of changes at once, by few filters: to compare them
    with each other only.
    """
    return np.array([trend.log_likelihood for trend in side_by_side(samples, alternatives, _FEW)])


_ALL = (tuple(_OWN_SCATTER.tolist()), _LEVEL_WALK, _SLOPE_WALK)


def side_by_side(
    samples: Samples,
    alternatives: Sequence[Sequence[Change]],
    sizes: tuple[Sequence[float], Sequence[float], Sequence[float]] = _ALL,
) -> list[LocalTrend]:
    """The same for several lists of changes at once; `sizes` are the relative σ, q_l and q_b of the
    filters.
    """
    t, y, x = samples.t, samples.y, samples.x
    scatter, pause = neighbours_scatter(y), float(np.mean(np.diff(t)))
    filters = np.array(list(product(*sizes)))
    rare, rarer = _WALK_IS_RARE
    prior = np.array(
        [rare ** sizes[1].index(a) * rarer ** sizes[2].index(b) for _, a, b in filters]
    )
    own, q_level, q_slope = (filters * scatter / [1.0, np.sqrt(pause), pause**1.5]).T
    span = max(float(np.ptp(y)), scatter)
    opened = np.array([(_OPEN * span) ** 2, (_OPEN * span / max(float(t[-1] - t[0]), pause)) ** 2])
    count = len(alternatives)
    m = np.zeros((count, len(filters), 2 + x.shape[1]))
    m[:, :, 0] = y[0]
    P = np.zeros((*m.shape, m.shape[2]))
    covariate = (_OPEN * span / np.maximum(np.max(np.abs(x), axis=0, initial=0.0), 1e-300)) ** 2
    P[:, :] = np.diag(np.concatenate([opened, covariate]))
    log_likelihood = np.zeros((count, len(filters)))
    opens = _opens(alternatives, len(t))
    for k in range(len(t)):
        if k:
            _predict(m, P, t[k] - t[k - 1], q_level, q_slope)
            P[:, :, 0, 0] += opens[:, k, 0, None] * opened[0]
            P[:, :, 1, 1] += opens[:, k, 1, None] * opened[1]
        log_likelihood += _update(m, P, y[k], samples.std[k] ** 2 + own**2, x[k])
    return [_weighed(log_likelihood[a], prior, m[a], P[a], q_level, q_slope) for a in range(count)]


def _opens(alternatives: Sequence[Sequence[Change]], n: int) -> npt.NDArray[np.bool_]:
    """Whether level and slope are opened, shape (alternatives, n, 2)."""
    opens = np.zeros((len(alternatives), n, 2), dtype=bool)
    for number, changes in enumerate(alternatives):
        for change in changes:
            opens[number, change.at] |= (change.kind != "slope", change.kind != "level")
    return opens


def _predict(
    m: FloatArray, P: FloatArray, h: float, q_level: FloatArray, q_slope: FloatArray
) -> None:
    m[..., 0] += h * m[..., 1]
    P[..., 0, :] += h * P[..., 1, :]
    P[..., :, 0] += h * P[..., :, 1]
    P[..., 0, 0] += q_level**2 * h + q_slope**2 * h**3 / 3.0
    P[..., 0, 1] += q_slope**2 * h**2 / 2.0
    P[..., 1, 0] += q_slope**2 * h**2 / 2.0
    P[..., 1, 1] += q_slope**2 * h


def _update(
    m: FloatArray, P: FloatArray, y: float, variance: FloatArray, x: FloatArray
) -> FloatArray:
    """Take one value; its log-likelihood by each filter."""
    row = np.concatenate([[1.0, 0.0], x])
    Pr = P @ row
    S = Pr @ row + variance
    e = y - m @ row
    gain = Pr / S[..., None]
    m += gain * e[..., None]
    P -= gain[..., :, None] * Pr[..., None, :]
    return np.asarray(-0.5 * (np.log(2.0 * np.pi * S) + e**2 / S))


def _weighed(
    log_likelihood: FloatArray,
    prior: FloatArray,
    m: FloatArray,
    P: FloatArray,
    q_level: FloatArray,
    q_slope: FloatArray,
) -> LocalTrend:
    raised = log_likelihood + np.log(prior / prior.sum())
    top = float(raised.max())
    weight = np.exp(raised - top)
    total = float(weight.sum())
    return LocalTrend(
        top + float(np.log(total)), weight / total, m.copy(), P.copy(), q_level, q_slope
    )


# When a value that follows a local trend will pass a limit, with what is uncertain in level,
# slope and their walk.

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


def time_to_limit(
    now: LocalTrend, limit: float, history: float, drifting: bool, confidence: float, seed: int
) -> TimeToLimit:
    """Draw futures from the posterior of level, slope and walk, and take the quantiles of their
    first passage.

    The limit lies above or below the value of now; what drifts away from it, or does not drift,
    cannot be said.
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
        return TimeToLimit(
            limit, None, None, None, confidence, "cannot say: the value drifts away from the limit"
        )
    passage = _passages(
        now, limit, 1.0 if above else -1.0, _HORIZON * history, np.random.default_rng(seed)
    )
    tail = (1.0 - confidence) / 2.0
    low, median, high = (
        _finite(float(np.quantile(passage, q, method="lower"))) for q in (tail, 0.5, 1.0 - tail)
    )
    return TimeToLimit(limit, median, low, high, confidence, "")


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _passages(
    now: LocalTrend, limit: float, sign: float, horizon: float, rng: np.random.Generator
) -> FloatArray:
    """First passage of each drawn future; infinite where there is none."""
    chosen = rng.choice(len(now.weight), _DRAWS, p=now.weight)
    P = now.covariance[chosen][:, :2, :2]
    root = np.linalg.cholesky(
        P + 1e-12 * np.maximum(np.einsum("fii->fi", P), 1e-300)[:, :, None] * np.eye(2)
    )
    state = now.mean[chosen][:, :2] + np.einsum(
        "fij,fj->fi", root, rng.standard_normal((_DRAWS, 2))
    )
    gap, slope = sign * (limit - state[:, 0]), sign * state[:, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        straight = np.where(gap <= 0.0, 0.0, np.where(slope > 0.0, gap / slope, np.inf))
    q_level, q_slope = now.level_walk[chosen], now.slope_walk[chosen]
    walking = (q_level > 0.0) | (q_slope > 0.0)
    passage = straight.copy()
    middle = np.median(straight[np.isfinite(straight)]) if np.isfinite(straight).any() else horizon
    futures = _Futures(gap[walking], slope[walking], q_level[walking], q_slope[walking])
    passage[walking] = _walked(futures, _times(middle, horizon), rng)
    return np.where(passage <= horizon, passage, np.inf)


class _Futures(NamedTuple):
    """Drawn futures, shape (futures,) each: what lies between the value and its limit now, how fast
    it shrinks, and how level and slope walk.
    """

    gap: FloatArray
    slope: FloatArray
    q_level: FloatArray
    q_slope: FloatArray


def _times(middle: float, horizon: float) -> list[float]:
    """Times at which futures are looked at: fine up to twice the middle passage of those that go
    straight, then ever coarser up to the horizon.
    """
    fine = np.linspace(0.0, min(2.0 * middle, horizon), _STEPS)
    coarse = np.geomspace(fine[-1] * 1.05, max(horizon, fine[-1] * 1.1), 40)
    return [*fine.tolist(), *coarse.tolist()]


def _walked(futures: _Futures, times: list[float], rng: np.random.Generator) -> FloatArray:
    """Passages of futures whose level or slope walks, from one time to the next, shape (futures,).

    A level that walks is given its deviation at each time by one draw: an excursion that comes back
    is no wear.
    """
    count = len(futures.gap)
    excursion = futures.q_level * rng.standard_normal(count)
    passage = np.full(count, np.inf)
    passage[futures.gap <= 0.0] = 0.0
    slope, gap = futures.slope.copy(), futures.gap.copy()
    for begin, end in pairwise(times):
        h = end - begin
        before = gap.copy()
        turn = futures.q_slope * np.sqrt(h) * rng.standard_normal(count)
        gap = gap - (slope + 0.5 * turn) * h - excursion * (np.sqrt(end) - np.sqrt(begin))
        slope = slope + turn
        passed = np.isinf(passage) & (gap <= 0.0)
        # where a straight line between the two times meets the limit
        closed = np.maximum(before[passed] - gap[passed], 1e-300)
        passage[passed] = begin + h * before[passed] / closed
    return passage


# A parameter or effect over many windows: drift, sudden change or recovery, and the time until it
# reaches a limit.

FEWEST_WINDOWS_OF_A_TRACK = 8
_MOST = 300
"""Samples that are followed; of longer histories neighbours are joined."""
_MARGIN = 3
"""Samples before and after a change."""
_MOST_CHANGES = 5
_WORTH = 2.5
"""Rise of the log-likelihood, beside the logarithm of the number of places tried, that a change
must bring.
"""
_REACH, _PLACES, _UNLIKELY = 60, 16, 7.0
"""Samples about the last change's place, the most likely of them that are kept, and by how much
less likely they may be.
"""
_TREND = 2.6
"""Standard deviations by which a slope must differ from zero to be called a drift."""
_CANDIDATES = 60
"""Places at which a change is tried first; the best one's neighbourhood is then tried at every
sample.
"""


@dataclass(frozen=True)
class TrackEvent:
    """Something that happened: `sudden-change`, `recovery` or `drift` that began; `size` is the
    jump, or the new slope.
    """

    at: float
    kind: str
    size: float


@dataclass(frozen=True)
class Track:
    """What a value does.

    Attributes
    ----------
    kind : str
        `steady`, `drift`, `sudden-change` or `recovery`: what holds now.
    since : float
        When that began.
    level, level_std, slope, slope_std : float
        At the last sample, without what the value was trained to move with.
    corrected : array
        The samples without what they move with.
    time : array
        Of each of them.
    events : sequence of TrackEvent
    remaining : TimeToLimit or None
        None without a limit.
    """

    kind: str
    since: float
    level: float
    level_std: float
    slope: float
    slope_std: float
    time: FloatArray
    corrected: FloatArray
    events: Sequence[TrackEvent]
    remaining: TimeToLimit | None

    def to_json(self) -> dict[str, Any]:
        """As plain values."""
        plain = {
            name: getattr(self, name)
            for name in ("kind", "since", "level", "level_std", "slope", "slope_std")
        }
        events = [vars(event) for event in self.events]
        left = None if self.remaining is None else vars(self.remaining)
        return {
            **plain,
            "time": self.time.tolist(),
            "corrected": self.corrected.tolist(),
            "events": events,
            "remaining": left,
        }


def track(
    time: npt.ArrayLike,
    value: npt.ArrayLike,
    std: npt.ArrayLike | None = None,
    *,
    moves_with: npt.ArrayLike | None = None,
    healthy: tuple[float, float] | None = None,
    limit: float | None = None,
    confidence: float = 0.9,
    seed: int = 0,
) -> Track:
    """Follow a value over irregular windows.

    Changes of level, of slope and of both at once (a repair ends the wear too) are sought one after
    the other, each where it raises the marginal likelihood of the local trend the most, until none
    is worth its place. Missing values are left out.

    Parameters
    ----------
    time, value, std : array, shape (n,)
        Times that rise, what each window told and with which standard deviation (default 0: the
        scatter is estimated).
    moves_with : array, shape (n, covariates), or None
        What the value moves with (temperature, load): its part is estimated beside the trend and
        taken off.
    healthy : (low, high) or None
        The healthy band; a jump back into it is a recovery.
    limit : float or None
        Value that must not be passed.
    confidence : float
        Of the band of the time to the limit.

    Raises
    ------
    BadInput
        Unequal lengths or times that do not rise.
    NotIdentifiable
        Fewer than 8 samples.

    Examples
    --------
    >>> t = np.arange(60.0)
    >>> y = 1 + 0.05 * t + 0.05 * np.random.default_rng(0).standard_normal(60)
    >>> found = track(t, y, limit=7.0)
    >>> found.kind, found.remaining.low < 60.0 < found.remaining.high
    ('drift', True)
    """
    samples = _joined(_samples(time, value, std, moves_with))
    changes = _changes(samples)
    now = local_trend(samples, _alike(samples, changes))
    t = samples.t
    mean, covariance = now.state
    corrected = samples.y - samples.x @ mean[2:]
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    drifting = bool(abs(mean[1]) > _TREND * deviation[1])
    events = _events(t, corrected, changes, healthy, drifting, float(mean[1]))
    kind, since = _now(events, drifting, float(t[0]))
    left = (
        None
        if limit is None
        else time_to_limit(now, float(limit), float(t[-1] - t[0]), drifting, confidence, seed)
    )
    return Track(
        kind,
        since,
        float(mean[0]),
        float(deviation[0]),
        float(mean[1]),
        float(deviation[1]),
        t,
        corrected,
        events,
        left,
    )


def _samples(
    time: npt.ArrayLike,
    value: npt.ArrayLike,
    std: npt.ArrayLike | None,
    moves_with: npt.ArrayLike | None,
) -> Samples:
    t, y = np.asarray(time, dtype=float), np.asarray(value, dtype=float)
    s = np.zeros_like(y) if std is None else np.asarray(std, dtype=float)
    x = (
        np.zeros((len(y), 0))
        if moves_with is None
        else np.asarray(moves_with, dtype=float).reshape(len(y), -1)
    )
    if t.ndim != 1 or t.shape != y.shape or t.shape != s.shape or not (np.diff(t) > 0).all():
        raise BadInput(
            f"track: times {t.shape}, values {y.shape} and deviations {s.shape} must be equal"
            " vectors, times rising"
        )
    finite = np.isfinite(y) & np.isfinite(s) & np.isfinite(x).all(axis=1)
    t, y, s, x = t[finite], y[finite], s[finite], x[finite]
    if len(t) < FEWEST_WINDOWS_OF_A_TRACK:
        raise NotIdentifiable(
            f"track: {len(t)} windows tell the value; at least {FEWEST_WINDOWS_OF_A_TRACK} are"
            " needed"
        )
    x = x - x.mean(axis=0)
    # a covariate that stands still cannot be told from the level
    return Samples(t, y, s, x[:, np.ptp(x, axis=0) > 0])


def _joined(samples: Samples) -> Samples:
    """Neighbours joined to at most 300 samples."""
    n = len(samples)
    every = -(-n // _MOST)
    if every == 1:
        return samples
    parts = np.array_split(np.arange(n), -(-n // every))
    t, y, x = (
        np.array([values[part].mean(axis=0) for part in parts])
        for values in (samples.t, samples.y, samples.x)
    )
    # of a mean of independent values
    std = [float(np.sqrt(np.mean(samples.std[part] ** 2) / len(part))) for part in parts]
    return Samples(t, y, np.array(std), x.reshape(len(parts), -1))


def _changes(samples: Samples) -> list[Change]:
    """Changes of level, slope or both, the most worthy first, until none is worth it."""
    changes: list[Change] = []
    base = float(likelihoods(samples, [[]])[0])
    end = len(samples) - _MARGIN + 1
    every = max(1, len(samples) // _CANDIDATES)
    while len(changes) < _MOST_CHANGES:
        best, gained = _best(samples, changes, range(_MARGIN, end, every))
        if best is not None and every > 1:
            nearby = range(max(_MARGIN, best.at - every), min(end, best.at + every + 1))
            best, gained = _best(samples, changes, nearby)
        # the logarithm pays for having chosen the best of so many places
        if best is None or gained - base < _WORTH + np.log(len(samples)):
            break
        changes, base = [*changes, best], gained
    return sorted(changes, key=lambda change: change.at)


def _alike(samples: Samples, changes: list[Change]) -> list[list[Change]]:
    """The changes with the last one at every place that is nearly as likely: where a drift began is
    not known for sure.
    """
    if not changes:
        return [[]]
    *earlier, last = changes
    begin = earlier[-1].at + _MARGIN if earlier else 1
    places = [k for k in range(begin, len(samples) - 1) if abs(k - last.at) <= _REACH]
    alternatives = [[*earlier, Change(k, last.kind)] for k in places]
    likely = likelihoods(samples, alternatives)
    near = np.argsort(-likely)[:_PLACES]
    return [alternatives[k] for k in near if likely[k] > likely.max() - _UNLIKELY]


def _best(samples: Samples, changes: list[Change], places: range) -> tuple[Change | None, float]:
    """The likeliest further change at one of these places, and the log-likelihood with it."""
    free = [k for k in places if all(abs(k - change.at) >= _MARGIN for change in changes)]
    candidates = [Change(k, kind) for k in free for kind in ("level", "slope", "renewal")]
    if not candidates:
        return None, -np.inf
    likely = likelihoods(samples, [[*changes, candidate] for candidate in candidates])
    best = int(np.argmax(likely))
    return candidates[best], float(likely[best])


def _events(
    t: FloatArray,
    y: FloatArray,
    changes: Sequence[Change],
    healthy: tuple[float, float] | None,
    drifting: bool,
    slope: float,
) -> list[TrackEvent]:
    events = []
    bounds = [0, *(change.at for change in changes), len(t)]
    for number, change in enumerate(changes, start=1):
        before, after = slice(bounds[number - 1], change.at), slice(change.at, bounds[number + 1])
        if change.kind != "slope":
            left, right = (
                _edge(t[before], y[before], t[change.at]),
                _edge(t[after], y[after], t[change.at]),
            )
            events.append(
                TrackEvent(float(t[change.at]), _jump(left, right, healthy), right - left)
            )
        if change.kind != "level" and change is changes[-1] and drifting:
            events.append(TrackEvent(float(t[change.at]), "drift", slope))
    return events


def _edge(t: FloatArray, y: FloatArray, at: float) -> float:
    """The value that a stretch has at one of its ends, by a line through its nearest samples."""
    near = np.argsort(np.abs(t - at))[:12]
    if len(near) < 4:
        return float(np.mean(y[near]))
    return float(np.polyval(np.polyfit(t[near] - at, y[near], 1), 0.0))


def _jump(before: float, after: float, healthy: tuple[float, float] | None) -> str:
    """A jump is a recovery where it leads from outside the healthy band to inside it, or most of
    the way.
    """
    if healthy is None:
        return "sudden-change"
    away = [max(healthy[0] - value, value - healthy[1], 0.0) for value in (before, after)]
    return "recovery" if away[0] > 0.0 and away[1] < 0.3 * away[0] else "sudden-change"


def _now(events: Sequence[TrackEvent], drifting: bool, begin: float) -> tuple[str, float]:
    last = events[-1] if events else None
    if drifting:
        return "drift", begin if last is None else last.at
    return ("steady", begin) if last is None else (last.kind, last.at)
