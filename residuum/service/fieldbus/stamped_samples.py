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
from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from residuum.service.fieldbus.health import SourceHealth
from residuum.service.fieldbus.sequence import BREAK
from residuum.service.fieldbus.source import Block, StreamFormat

# Seconds by which stamps may run ahead of the time that has passed here: a reader that was late
# catches up.
_AHEAD = 2.0
# Seconds a second by which the clocks may drift apart.
_DRIFT = 1e-3
# [s] For which first reports are collected, and for which a held channel may still report.
_FIRST = 0.3
# Steps by which a first report is older than the newest to state what holds, and no more.
_OLD = 1.5
# Samples that tell whether a channel reports by change, and that it takes to tell that it does not.
_REPORTS, _FEWEST_REPORTS = 10, 4
# Samples that wait; of more, the oldest is lost: the memory that a source takes is bounded.
_MOST_OPEN = 100_000


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
        # before repetitions: a clock that is set back may give a stamp that was there before
        if self._was_set(channel, stamp, now):
            self._begin_anew(now)
            return
        if self._last.get(channel) == stamp:
            self._health.count("duplicated", 1)
            return
        self._last[channel] = stamp
        # the server's clock less ours, by the value that was the least on its way; it may shrink no
        # faster than clocks drift
        self._offset, self._seen = max(stamp - now, self._offset - _DRIFT * (now - self._seen)), now
        self._origin = stamp if self._origin is None else self._origin
        number = self._base + round((stamp - self._origin) / self.format.sample_time)
        if self._delivered is not None and number <= self._delivered:
            self._take_late(channel, value)
        else:
            self._put(number, channel, value)

    def _take_late(self, channel: str, value: float) -> None:
        """A value of a sample that was handed on."""
        if self._held is not None:
            self._holds[channel] = value
            if self._holding(channel):
                return  # it holds from the next sample on
        self._health.count(
            "late_values", 1, f"{self.format.name}: a value came after its sample was handed on"
        )

    def _put(self, number: int, channel: str, value: float) -> None:
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
        ready = self._ready()
        if not ready:
            return None
        rows = [self._with_held(self._open.pop(number)) for number in ready]
        missing = self._missing_of(ready)
        if missing:
            self._health.count("lost", missing, f"{self.format.name}: {missing} samples never came")
        self._delivered = ready[-1]
        channels = {
            name: np.array([row.get(name, math.nan) for row in rows]) for name in self.format.units
        }
        return Block(self.format.name, np.array(ready, np.int64), channels)

    def _ready(self) -> list[int]:
        """Take from the queue the numbers of the samples that wait no longer, in order.

        The first that has to wait keeps those behind it back, too: samples leave in order.
        """
        overdue = self._newest - math.ceil(self._patience / self.format.sample_time)
        ready = []
        while self._order and (self._order[0] <= overdue or self._is_whole(self._order[0])):
            ready.append(heapq.heappop(self._order))
        return ready

    def _missing_of(self, ready: list[int]) -> int:
        """Samples that never came, up to the last of these and since the last that was handed on."""
        # across a BREAK the distance is not known: what was lost there was counted when it began
        if self._delivered is not None and ready[0] - self._delivered < BREAK // 2:
            return ready[-1] - self._delivered - len(ready)
        return ready[-1] - ready[0] + 1 - len(ready)

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
        # until it has shown otherwise, a channel is taken for one that reports by change
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
        # stamps that lag are a slow server's or network's, unless the connection was lost meanwhile
        behind = self._reopened and ahead < -_AHEAD
        self._reopened = False
        return back or behind or ahead > _AHEAD

    def _begin_anew(self, now: float) -> None:
        self._health.count("counter_jumps", 1, f"{self.format.name}: the server's clock was set")
        # the samples that wait are given up, and the value that showed it is not taken
        self._health.count("lost", len(self._open) + 1)
        top = max(self._newest, self._delivered if self._delivered is not None else 0)
        self._base = (top // BREAK + 1) * BREAK
        self._open.clear()
        self._order.clear()
        self._last.clear()
        self._origin, self._offset, self._newest = None, -math.inf, self._base - 1
        self._closed_until = now + self._quarantine


# ReportedChanges: samples of values that are reported when they change.
#
# A Sparkplug node reports by exception: what a message does not name has not changed. So each
# sample before a change has the values that held until then. It can be given only when the next
# message comes: before, nobody knows that nothing changed.

# [s] A longer silence is a hole: what it would fill, windows are not made of.
_LONGEST = 3600.0
# A silence of more samples, or of more values in them, is a hole, too: they wait in memory until
# they are handed on.
_MOST_SAMPLES, _MOST_VALUES = 50_000, 1_000_000

Report = tuple[float, str, float]
"""Stamp [s], channel, value."""


class ReportedChanges:
    """The channels of one stream.

    After a hole the stream goes on with the change that ends it: what is missing shows in the
    stamps, and is counted where samples are put together.

    Parameters
    ----------
    channels : sequence of str
    sample_time : float
        [s]

    Examples
    --------
    >>> changes = ReportedChanges(["u", "y"], 1.0)
    >>> changes.stated([(10.0, "u", 5.0), (10.0, "y", 7.0)])
    >>> list(changes.samples([(11.0, "u", 6.0)]))
    []
    >>> list(changes.samples([(13.0, "y", 8.0)]))
    [(11.0, 'u', 6.0), (11.0, 'y', 7.0), (12.0, 'u', 6.0), (12.0, 'y', 7.0)]
    """

    def __init__(self, channels: Sequence[str], sample_time: float) -> None:
        self._channels, self._step = channels, sample_time
        self._longest = min(
            _LONGEST, sample_time * min(_MOST_SAMPLES, _MOST_VALUES // len(channels))
        )
        self._holds: dict[str, float] = {}
        self._origin: float | None = None
        self._next = 0

    def forget(self) -> None:
        """Nothing is known any more."""
        self._holds, self._origin = {}, None

    def stated(self, states: Iterable[Report]) -> None:
        """A birth states what holds; it is no sample, since it says when it was sent, not when the
        value began to hold.
        """
        self._holds |= {channel: value for _, channel, value in states}

    def samples(self, changes: Iterable[Report]) -> Iterator[Report]:
        """The samples before these changes that were not given yet; `changes` in the order of
        stamps.

        They come one by one, and the changes are noted as they do: take them all.
        """
        for stamp, channel, value in changes:
            yield from self._until(stamp)
            self._holds[channel] = value

    def _until(self, stamp: float) -> Iterator[Report]:
        silence = 0.0 if self._origin is None else stamp - self._time(self._next)
        if self._origin is None or not -self._step <= silence <= self._longest:
            self._origin, self._next = stamp, 0
            return
        end = round((stamp - self._origin) / self._step)
        begin, self._next = self._next, max(self._next, end)
        for number in range(begin, end):
            at = self._time(number)
            for name in self._channels:
                if name in self._holds:
                    yield at, name, self._holds[name]

    def _time(self, number: int) -> float:
        return (self._origin or 0.0) + number * self._step
