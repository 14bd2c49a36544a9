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
    "pauses": "times that a message without a counter paused: what was lost meanwhile is not known, no window reaches across",
    "undecodable": "frames of wrong length or form",
    "bus_errors": "error frames, bus-off, a bus that could not be opened or read",
    "modbus_exceptions": "exception replies of a Modbus device",
    "short_replies": "Modbus replies with another number of registers than asked for",
    "late_replies": "Modbus replies to a request that had been given up, dropped",
    "corrupt_replies": "Modbus replies whose checksum or sequence number is wrong, dropped",
    "timeouts": "Modbus requests without a reply in time",
    "reconnects": "times the source was opened again",
    "bad_status": "OPC UA and Sparkplug values whose status is not good, taken as missing",
    "unstamped": "OPC UA values without a source time stamp, dropped",
    "late_values": "OPC UA and Sparkplug values that came after their sample had been handed on, dropped",
    "sequence_gaps": "gaps in the sequence of a Sparkplug node: nothing is taken until it is born again",
    "unborn": "Sparkplug messages and values that came before a birth or after a gap, dropped",
    "rebirths_asked": "times a Sparkplug node was asked to be born again",
    "surplus": "OPC UA and Sparkplug values of a sample that has one already, dropped: they come faster than the map says",
    "overflow": "Sparkplug messages that came faster than they were read, dropped: the node is asked to be born again",
    "queue_drops": "samples dropped because the windows could not be cut fast enough",
}
"""Name of each loss counter and what it counts."""

_RATE_OVER = 5.0  # seconds


class SourceHealth:
    """Counters, rates and staleness of one source; safe to use from any thread.

    Parameters
    ----------
    stale_after : float
        Seconds without a good frame after which the source counts as stale.
    clock : callable
        Monotonic seconds; wall-clock jumps must not matter.

    `remarks` are sentences that hold as long as the source does, such as a message without a counter; with one, quality is
    `uncounted` instead of `good`. `doubts` are, by stream, sentences about values that look wrong; with one, it is `doubtful`.
    """

    def __init__(self, stale_after: float = 2.0, clock: Callable[[], float] = time.monotonic) -> None:
        self.remarks: Sequence[str] = ()
        self.doubts: dict[str, Sequence[str]] = {}
        self._counts = dict.fromkeys(COUNTERS, 0)
        self._frames = self._samples = 0
        self._seen: float | None = None
        self._recent: deque[tuple[float, int, int]] = deque()
        self._trouble = ""
        self._stale_after, self._clock = stale_after, clock
        self._lock = threading.Lock()

    def count(self, name: str, times: int = 1, trouble: str = "") -> None:
        """Add to a loss counter (`lost` may also go down, when a late frame arrives); `trouble` says what happened."""
        with self._lock:
            self._counts[name] += times
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

    def snapshot(self) -> dict[str, Any]:
        """What the interface shows: quality, rates over the last seconds, counters, age of the last frame [s]."""
        now = self._clock()
        with self._lock:
            recent = [entry for entry in self._recent if entry[0] >= now - _RATE_OVER]
            span = max(now - recent[0][0], 0.2) if recent else _RATE_OVER
            age = None if self._seen is None else now - self._seen
            return {
                "quality": self._quality(age),
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
        if age > self._stale_after:
            return "stale"
        return "doubtful" if self._doubts() else "uncounted" if self.remarks else "good"

    def _doubts(self) -> list[str]:
        return [sentence for sentences in list(self.doubts.values()) for sentence in sentences]
