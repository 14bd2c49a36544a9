"""SourceHealth: every loss and every sign of life of one source, counted and timed."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

COUNTERS = {
    "lost": "frames or pages that the sequence counter says were sent and that never came",
    "duplicated": "frames that came twice (the second one is dropped)",
    "reordered": "frames that came late and were put in their place",
    "counter_jumps": "jumps of the sequence counter that no loss explains (a restarted device)",
    "pauses": (
        "times that a message without a counter paused: what was lost meanwhile is not known, no"
        " window reaches across"
    ),
    "undecodable": "frames of wrong length or form",
    "bus_errors": "error frames, bus-off, a bus that could not be opened or read",
    "modbus_exceptions": "exception replies of a Modbus device",
    "short_replies": "Modbus replies with another number of registers than asked for",
    "late_replies": "Modbus replies to a request that had been given up, dropped",
    "corrupt_replies": "Modbus replies whose checksum or sequence number is wrong, dropped",
    "timeouts": "Modbus requests without a reply in time",
    "reconnects": "times the source was opened again",
    "bad_status": (
        "values whose status is not good, or that are of another type than a number, taken as missing"
    ),
    "no_value": (
        "values that say of themselves that there is none, taken as missing: an infinite number, a"
        " code for it on CAN, what a register map calls missing, an empty cell of a file, a null of JSON"
    ),
    "unstamped": "values and messages without a time stamp, dropped",
    "late_values": ("stamped values that came after their sample had been handed on, dropped"),
    "sequence_gaps": (
        "gaps in the sequence of a Sparkplug node: nothing is taken until it is born again"
    ),
    "unborn": "Sparkplug messages and values that came before a birth or after a gap, dropped",
    "rebirths_asked": "times a Sparkplug node was asked to be born again",
    "surplus": (
        "stamped values of a sample that has one already, dropped: they come faster"
        " than the map says"
    ),
    "overflow": (
        "messages of a broker that came faster than they were read, dropped: a Sparkplug node is"
        " asked to be born again"
    ),
    "queue_drops": "samples dropped because the windows could not be cut fast enough",
}
"""Name of each loss counter and what it counts."""

LOSSES = frozenset(("lost", "undecodable", "unstamped", "late_values", "overflow", "queue_drops"))
"""Counters of what was sent and is missing from the windows."""
LOSSES_OVER = 60.0
"""Seconds for which a loss keeps a source from being called good."""
# [s] Over which rates are means.
_RATE_OVER = 5.0


class SourceHealth:
    """Counters, rates and staleness of one source; safe to use from any thread.

    Parameters
    ----------
    stale_after : float
        Seconds without a good frame after which the source counts as stale.
    clock : callable
        Monotonic seconds; wall-clock jumps must not matter.

    `remarks` are sentences that hold as long as the source does, such as a message without a
    counter; with one, quality is `uncounted` instead of `good`. `doubts` are, by stream, sentences
    about values that look wrong; with one, it is `doubtful`. With losses within the last minute it
    is `losing`.
    """

    def __init__(
        self, stale_after: float = 2.0, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.remarks: Sequence[str] = ()
        self.doubts: dict[str, Sequence[str]] = {}
        self._counts = dict.fromkeys(COUNTERS, 0)
        self._frames = self._samples = 0
        self._seen: float | None = None
        self._recent: deque[tuple[float, int, int]] = deque()
        self._losses: dict[int, int] = {}
        self._trouble = ""
        self._stale_after, self._clock = stale_after, clock
        self._lock = threading.Lock()

    def count(self, name: str, times: int = 1, trouble: str = "") -> None:
        """Add to a loss counter (`lost` may also go down, when a late frame arrives); `trouble`
        says what happened.
        """
        with self._lock:
            self._counts[name] += times
            if name in LOSSES:
                second = int(self._clock())
                self._forget_losses(second)
                self._losses[second] = self._losses.get(second, 0) + times
            self._trouble = trouble or self._trouble

    def received(self, frames: int, samples: int) -> None:
        """Note good frames (or pages) and the samples in them."""
        now = self._clock()
        with self._lock:
            self._frames += frames
            self._samples += samples
            self._seen = now
            self._recent.append((now, frames, samples))
            while self._recent and self._recent[0][0] < now - _RATE_OVER:
                self._recent.popleft()

    def __getitem__(self, name: str) -> int:
        with self._lock:
            return self._counts[name]

    def silence(self) -> str:
        """What is said of a source that gives nothing now, with its last trouble; empty for one
        that gives something.
        """
        now = self._clock()
        with self._lock:
            age = None if self._seen is None else now - self._seen
            if age is not None and age <= self._stale_after:
                return ""
            trouble = f" ({self._trouble})" if self._trouble else ""
            return ("gave nothing yet" if age is None else "gives nothing any more") + trouble

    def snapshot(self) -> dict[str, Any]:
        """What the interface shows: quality, rates over the last seconds, counters, age of the last
        frame [s].
        """
        now = self._clock()
        with self._lock:
            recent = [entry for entry in self._recent if entry[0] >= now - _RATE_OVER]
            # a single batch that came this moment would have a rate without bound
            span = max(now - recent[0][0], 0.2) if recent else _RATE_OVER
            age = None if self._seen is None else now - self._seen
            return {
                "quality": self._quality(age),
                "lost_lately": self._lost_lately(),
                "lost_within_seconds": LOSSES_OVER,
                "last_seen_seconds": age,
                "frames": self._frames,
                "samples": self._samples,
                "frames_per_second": sum(entry[1] for entry in recent) / span,
                "samples_per_second": sum(entry[2] for entry in recent) / span,
                "counters": dict(self._counts),
                "last_trouble": self._trouble,
                "remarks": [*self.remarks, *self._doubts()],
            }

    def _quality(self, age: float | None) -> str:
        if age is None:
            return "never-seen"
        # worst first: only one word is shown
        if age > self._stale_after:
            return "stale"
        if self._doubts():
            return "doubtful"
        if self._lost_lately():
            return "losing"
        return "uncounted" if self.remarks else "good"

    def _lost_lately(self) -> int:
        self._forget_losses(int(self._clock()))
        # late frames take a loss back, perhaps one that is forgotten already: never below 0
        return max(0, sum(self._losses.values()))

    def _forget_losses(self, second: int) -> None:
        """Keep a number a second, of the last minute: a bus that loses every frame must not fill
        the memory.
        """
        while self._losses and (oldest := next(iter(self._losses))) < second - LOSSES_OVER:
            del self._losses[oldest]

    def _doubts(self) -> list[str]:
        return [sentence for sentences in list(self.doubts.values()) for sentence in sentences]
