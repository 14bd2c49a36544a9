"""A parameter or effect over many windows: drift, sudden change or recovery, and the time until it reaches a limit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.diagnosis.tracks.local_trend import Change, likelihoods, local_trend
from residuum.diagnosis.tracks.time_to_limit import TimeToLimit, time_to_limit
from residuum.identification.errors import BadInput, NotIdentifiable

FEWEST_WINDOWS_OF_A_TRACK = 8
_MOST = 300
"""Samples that are followed; of longer histories neighbours are joined."""
_MARGIN = 3
"""Samples before and after a change."""
_MOST_CHANGES = 5
_WORTH = 2.5
"""Rise of the log-likelihood, beside the logarithm of the number of places tried, that a change must bring."""
_REACH, _PLACES, _UNLIKELY = 60, 16, 7.0
"""Samples about the last change's place, the most likely of them that are kept, and by how much less likely they may be."""
_TREND = 2.6
"""Standard deviations by which a slope must differ from zero to be called a drift."""
_CANDIDATES = 60
"""Places at which a change is tried first; the best one's neighbourhood is then tried at every sample."""


@dataclass(frozen=True)
class TrackEvent:
    """Something that happened: `sudden-change`, `recovery` or `drift` that began; `size` is the jump, or the new slope."""

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
        plain = {name: getattr(self, name) for name in ("kind", "since", "level", "level_std", "slope", "slope_std")}
        events = [vars(event) for event in self.events]
        left = None if self.remaining is None else vars(self.remaining)
        return {**plain, "time": self.time.tolist(), "corrected": self.corrected.tolist(), "events": events, "remaining": left}


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

    Changes of level, of slope and of both at once (a repair ends the wear too) are sought one after the other, each where it
    raises the marginal likelihood of the local trend the most, until none is worth its place. Missing values are left out.

    Parameters
    ----------
    time, value, std : array, shape (n,)
        Times that rise, what each window told and with which standard deviation (default 0: the scatter is estimated).
    moves_with : array, shape (n, covariates), or None
        What the value moves with (temperature, load): its part is estimated beside the trend and taken off.
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
    t, y, s, x = _samples(time, value, std, moves_with)
    t, y, s, x = _joined(t, y, s, x)
    changes = _changes(t, y, s, x)
    now = local_trend(t, y, s, x, _alike(t, y, s, x, changes))
    mean, covariance = now.state
    corrected = y - x @ mean[2:]
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    drifting = bool(abs(mean[1]) > _TREND * deviation[1])
    events = _events(t, corrected, changes, healthy, drifting, float(mean[1]))
    kind, since = _now(events, drifting, float(t[0]))
    left = None if limit is None else time_to_limit(now, float(limit), float(t[-1] - t[0]), drifting, confidence, seed)
    return Track(
        kind, since, float(mean[0]), float(deviation[0]), float(mean[1]), float(deviation[1]), t, corrected, events, left
    )


def _samples(
    time: npt.ArrayLike, value: npt.ArrayLike, std: npt.ArrayLike | None, moves_with: npt.ArrayLike | None
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    t, y = np.asarray(time, dtype=float), np.asarray(value, dtype=float)
    s = np.zeros_like(y) if std is None else np.asarray(std, dtype=float)
    x = np.zeros((len(y), 0)) if moves_with is None else np.asarray(moves_with, dtype=float).reshape(len(y), -1)
    if t.ndim != 1 or t.shape != y.shape or t.shape != s.shape or not (np.diff(t) > 0).all():
        raise BadInput(f"track: times {t.shape}, values {y.shape} and deviations {s.shape} must be equal vectors, times rising")
    kept = np.isfinite(y) & np.isfinite(s) & np.isfinite(x).all(axis=1)
    t, y, s, x = t[kept], y[kept], s[kept], x[kept]
    if len(t) < FEWEST_WINDOWS_OF_A_TRACK:
        raise NotIdentifiable(f"track: {len(t)} windows tell the value; at least {FEWEST_WINDOWS_OF_A_TRACK} are needed")
    x = x - x.mean(axis=0)
    return t, y, s, x[:, np.ptp(x, axis=0) > 0]


def _joined(t: FloatArray, y: FloatArray, s: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Neighbours joined to at most 300 samples."""
    every = -(-len(t) // _MOST)
    if every == 1:
        return t, y, s, x
    parts = np.array_split(np.arange(len(t)), -(-len(t) // every))
    means = [[a[p].mean(axis=0) for p in parts] for a in (t, y, x)]
    joint = [float(np.sqrt(np.mean(s[p] ** 2) / len(p))) for p in parts]
    return np.array(means[0]), np.array(means[1]), np.array(joint), np.array(means[2]).reshape(len(parts), -1)


def _changes(t: FloatArray, y: FloatArray, s: FloatArray, x: FloatArray) -> list[Change]:
    """Changes of level, slope or both, the most worthy first, until none is worth it."""
    found: list[Change] = []
    base = float(likelihoods(t, y, s, x, [[]])[0])
    while len(found) < _MOST_CHANGES:
        every = max(1, len(t) // _CANDIDATES)
        best, gained = _best(t, y, s, x, found, range(_MARGIN, len(t) - _MARGIN + 1, every))
        if best is not None and every > 1:
            best, gained = _best(
                t, y, s, x, found, range(max(_MARGIN, best.at - every), min(len(t) - _MARGIN, best.at + every) + 1)
            )
        if best is None or gained - base < _WORTH + np.log(len(t)):
            break
        found, base = [*found, best], gained
    return sorted(found, key=lambda change: change.at)


def _alike(t: FloatArray, y: FloatArray, s: FloatArray, x: FloatArray, changes: list[Change]) -> list[list[Change]]:
    """The changes with the last one at every place that is nearly as likely: where a drift began is not known for sure."""
    if not changes:
        return [[]]
    *others, last = changes
    begin = others[-1].at + _MARGIN if others else 1
    places = [k for k in range(begin, len(t) - 1) if abs(k - last.at) <= _REACH]
    alternatives = [[*others, Change(k, last.kind)] for k in places]
    likely = likelihoods(t, y, s, x, alternatives)
    near = np.argsort(-likely)[:_PLACES]
    return [alternatives[k] for k in near if likely[k] > likely.max() - _UNLIKELY]


def _best(
    t: FloatArray, y: FloatArray, s: FloatArray, x: FloatArray, found: list[Change], places: range
) -> tuple[Change | None, float]:
    free = [k for k in places if all(abs(k - change.at) >= _MARGIN for change in found)]
    candidates = [Change(k, kind) for k in free for kind in ("level", "slope", "renewal")]
    if not candidates:
        return None, -np.inf
    likely = likelihoods(t, y, s, x, [[*found, candidate] for candidate in candidates])
    best = int(np.argmax(likely))
    return candidates[best], float(likely[best])


def _events(
    t: FloatArray, y: FloatArray, changes: Sequence[Change], healthy: tuple[float, float] | None, drifting: bool, slope: float
) -> list[TrackEvent]:
    events = []
    bounds = [0, *(change.at for change in changes), len(t)]
    for number, change in enumerate(changes, start=1):
        before, after = slice(bounds[number - 1], change.at), slice(change.at, bounds[number + 1])
        if change.kind != "slope":
            left, right = _edge(t[before], y[before], t[change.at]), _edge(t[after], y[after], t[change.at])
            events.append(TrackEvent(float(t[change.at]), _jump(left, right, healthy), right - left))
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
    """A jump is a recovery where it leads from outside the healthy band to inside it, or most of the way."""
    if healthy is None:
        return "sudden-change"
    away = [max(healthy[0] - value, value - healthy[1], 0.0) for value in (before, after)]
    return "recovery" if away[0] > 0.0 and away[1] < 0.3 * away[0] else "sudden-change"


def _now(events: Sequence[TrackEvent], drifting: bool, begin: float) -> tuple[str, float]:
    last = events[-1] if events else None
    if drifting:
        return "drift", begin if last is None else last.at
    return ("steady", begin) if last is None else (last.kind, last.at)
