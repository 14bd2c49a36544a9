"""StampedSamples: values that come one by one, each with its own time stamp, put together into
samples of a stream.

A value belongs to the sample nearest to its stamp. Stamps are those of the server's clock, which
may be set: a stamp that steps back, or that runs ahead of our own clock, begins the stream anew
(its numbers advance by `BREAK`), and for `quarantine` seconds nothing is taken, since values of
other channels may still be stamped by the clock as it was. A sample is handed on once it is
complete, or once it is `patience` seconds older than the newest: what is missing then is NaN.
"""

from __future__ import annotations

import heapq
import math
from collections import deque
from collections.abc import Mapping

import numpy as np

from residuum.service.fieldbus.health import SourceHealth
from residuum.service.fieldbus.sequence import BREAK
from residuum.service.fieldbus.source import Block, StreamFormat

_AHEAD = 2.0
"""Seconds by which stamps may run ahead of the time that has passed here: a reader that was late
catches up.
"""
_DRIFT = 1e-3
"""Seconds a second by which the clocks may drift apart."""
_FIRST, _OLD = 0.3, 1.5
"""Seconds for which first reports are collected; steps by which one is older than the newest to
state what holds, no more.
"""
_REPORTS, _FEWEST_REPORTS = 10, 4
"""Samples that tell whether a channel reports by change, and that it takes to tell that it does
not.
"""
_MOST_OPEN = 100_000
"""Samples that wait; of more, the oldest is lost."""


class StampedSamples:
    """One stream that is put together.

    Parameters
    ----------
    format : StreamFormat
    health : SourceHealth
        Counts what is lost (samples that never came whole are missing, not lost), repeated, or
        stamped by a clock that was set.
    patience, quarantine : float
        See the module [s].
    held : mapping of channel to bool or None, or None
        Of a source that reports changes: whether a channel's last value, or that it has none, holds
        until its next report. None for a channel: where it reported in less than half of the last
        samples. Its first report is stated, not stamped: it may say when the value was written,
        long ago. None: nothing is held.

    Examples
    --------
    >>> samples = StampedSamples(StreamFormat("a", 0.1, {"u": "V", "y": "m"}), SourceHealth())
    >>> for k in range(2):
    ...     samples.add("u", 10.0 + 0.1 * k, float(k), now=0.1 * k)
    ...     samples.add("y", 10.0 + 0.1 * k, -float(k), now=0.1 * k)
    >>> samples.take(now=0.2).channels["y"].tolist()
    [-0.0, -1.0]
    """

    def __init__(
        self,
        format: StreamFormat,
        health: SourceHealth,
        patience: float = 1.0,
        quarantine: float = 1.0,
        held: Mapping[str, bool | None] | None = None,
    ) -> None:
        self.format, self._held = format, held
        self._holds: dict[str, float] = {}
        self._reports: dict[str, deque[bool]] = {
            name: deque(maxlen=_REPORTS) for name in format.units
        }
        self._first: list[tuple[float, str, float]] | None = None if held is None else []
        self._first_until = math.inf
        self._health, self._patience, self._quarantine = health, patience, quarantine
        self._open: dict[int, dict[str, float]] = {}
        self._order: list[int] = []
        """The numbers of the open samples, as a heap."""
        self._last: dict[str, float] = {}
        self._base = 0
        self._origin: float | None = None
        self._delivered: int | None = None
        self._newest = -1
        self._closed_until = -math.inf
        self._offset, self._seen = -math.inf, 0.0
        self._reopened = False

    def reopened(self) -> None:
        """The connection was lost and is there again: the server's clock may have been set in
        either direction meanwhile.
        """
        self._reopened = True
        if self._held is not None:
            self._first, self._first_until, self._holds = [], math.inf, {}

    def add(self, channel: str, stamp: float, value: float, now: float) -> None:
        """A value of a channel; `stamp` [s] is the server's, `now` our monotonic clock [s]."""
        if self._first is None:
            self._add(channel, stamp, value, now)
            return
        self._first_until = min(self._first_until, now + _FIRST)
        self._first.append((stamp, channel, value))
        if now >= self._first_until:
            self._open_stream(now)

    def _open_stream(self, now: float) -> None:
        """Take what came first: old reports state what holds, the others are samples."""
        first, self._first = sorted(self._first or []), None
        newest = first[-1][0] if first else 0.0
        for stamp, channel, value in first:
            if stamp < newest - _OLD * self.format.sample_time:
                self._holds[channel] = value
            else:
                self._add(channel, stamp, value, now)

    def _add(self, channel: str, stamp: float, value: float, now: float) -> None:
        if now < self._closed_until:
            self._health.count("lost", 1)
            return
        if self._was_set(channel, stamp, now):
            self._begin_anew(now)
            return
        if self._last.get(channel) == stamp:
            self._health.count("duplicated", 1)
            return
        self._last[channel] = stamp
        self._offset, self._seen = max(stamp - now, self._offset - _DRIFT * (now - self._seen)), now
        self._origin = stamp if self._origin is None else self._origin
        number = self._base + round((stamp - self._origin) / self.format.sample_time)
        if self._delivered is not None and number <= self._delivered:
            if self._held is not None:
                self._holds[channel] = value
                if self._holding(channel):
                    return  # it holds from the next sample on
            self._health.count(
                "late_values", 1, f"{self.format.name}: a value came after its sample was handed on"
            )
            return
        if number not in self._open:
            heapq.heappush(self._order, number)
        row = self._open.setdefault(number, {})
        if channel in row:
            self._health.count("surplus", 1)
            return
        row[channel] = value
        self._newest = max(self._newest, number)
        if len(self._open) > _MOST_OPEN:
            del self._open[heapq.heappop(self._order)]
            self._health.count("lost", 1)

    def take(self, now: float) -> Block | None:
        """The samples that are ready, in order; None when none are."""
        if self._first and now >= self._first_until:
            self._open_stream(now)
        overdue = self._newest - math.ceil(self._patience / self.format.sample_time)
        ready = []
        while self._order and (self._order[0] <= overdue or self._is_whole(self._order[0])):
            ready.append(heapq.heappop(self._order))
        if not ready:
            return None
        rows = [self._with_held(self._open.pop(number)) for number in ready]
        if self._delivered is not None and ready[0] - self._delivered < BREAK // 2:
            missing = ready[-1] - self._delivered - len(ready)
        else:
            missing = ready[-1] - ready[0] + 1 - len(ready)
        if missing:
            self._health.count("lost", missing, f"{self.format.name}: {missing} samples never came")
        self._delivered = ready[-1]
        channels = {
            name: np.array([row.get(name, math.nan) for row in rows]) for name in self.format.units
        }
        return Block(self.format.name, np.array(ready, np.int64), channels)

    def _is_whole(self, number: int) -> bool:
        """Whether nothing is awaited of a sample: channels that are held are, for as long as a
        message takes.
        """
        lacking = [name for name in self.format.units if name not in self._open[number]]
        if not lacking:
            return True
        waited = (self._newest - number) * self.format.sample_time >= _FIRST
        return self._held is not None and waited and all(map(self._holding, lacking))

    def _holding(self, channel: str) -> bool:
        """Whether a channel's last value holds where none is reported."""
        declared = None if self._held is None else self._held.get(channel)
        if declared is not None or self._held is None:
            return bool(declared)
        reports = self._reports[channel]
        return len(reports) < _FEWEST_REPORTS or 2 * sum(reports) < len(reports)

    def _with_held(self, row: dict[str, float]) -> dict[str, float]:
        """A sample with what holds in it."""
        if self._held is None:
            return row
        whole = {
            name: self._holds[name]
            for name in self.format.units
            if name in self._holds and self._holding(name)
        } | row
        self._holds |= row
        for name, reports in self._reports.items():
            reports.append(name in row)
        return whole

    def _was_set(self, channel: str, stamp: float, now: float) -> bool:
        """Whether this stamp says that the server's clock was set since the last one."""
        if self._origin is None:
            return False
        ahead = stamp - now - self._offset
        back = stamp < self._last.get(channel, -math.inf)
        behind = self._reopened and ahead < -_AHEAD
        self._reopened = False
        return back or behind or ahead > _AHEAD

    def _begin_anew(self, now: float) -> None:
        held: Mapping[int, object] = self._open
        self._health.count("counter_jumps", 1, f"{self.format.name}: the server's clock was set")
        self._health.count("lost", len(held) + 1)
        top = max(self._newest, self._delivered if self._delivered is not None else 0)
        self._base = (top // BREAK + 1) * BREAK
        self._open.clear()
        self._order.clear()
        self._last.clear()
        self._origin, self._offset, self._newest = None, -math.inf, self._base - 1
        self._closed_until = now + self._quarantine
