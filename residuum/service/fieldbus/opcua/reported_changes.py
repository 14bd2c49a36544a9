"""ReportedChanges: samples of values that are reported when they change.

A Sparkplug node reports by exception: what a message does not name has not changed. So each sample
before a change has the values that held until then. It can be given only when the next message
comes: before, nobody knows that nothing changed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

_LONGEST = 3600.0
"""[s] A longer silence is a hole: what it would fill, windows are not made of."""
_MOST_SAMPLES, _MOST_VALUES = 50_000, 1_000_000
"""A silence of more samples, or of more values in them, is a hole, too: they wait in memory until
they are handed on.
"""

Told = tuple[float, str, float]
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

    def stated(self, states: Iterable[Told]) -> None:
        """A birth states what holds; it is no sample, since it says when it was sent, not when the
        value began to hold.
        """
        self._holds |= {channel: value for _, channel, value in states}

    def samples(self, changes: Iterable[Told]) -> Iterator[Told]:
        """The samples before these changes that were not given yet; `changes` in the order of
        stamps.

        They come one by one, and the changes are noted as they do: take them all.
        """
        for stamp, channel, value in changes:
            yield from self._until(stamp)
            self._holds[channel] = value

    def _until(self, stamp: float) -> Iterator[Told]:
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
