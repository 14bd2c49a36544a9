"""The clock of a CAN log: where it was set while frames went on coming, and by how much.

A step back is seen in the order of the frames: two in a row before one that came earlier. A step forward looks like a pause, and
is told from one where the counters go on as if nothing had been lost; one of an hour is as good as a pause, for a counter goes
round too often meanwhile. What lies on both sides is brought together by the counters, else by the period of the fastest message,
which takes for granted that nothing was lost in that moment.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.service.fieldbus.block import Samples
from residuum.service.fieldbus.can.can_log import TimedFrame
from residuum.service.fieldbus.can.frame_layout import FrameLayout

_DISORDER = 1e-3
"""Seconds by which frames of several buses may stand in another order than they came."""
_PAUSE, _LONG = 20.0, 0.3
"""Periods of the fastest message, and seconds, from which on a pause may be a clock that was set."""
_OFF, _OFF_PART = 2.0, 0.005
"""Frames, and the part of a pause, by which a counter and the clock may differ."""


@dataclass(frozen=True, eq=False)
class _Stream:
    """The frames of one message: their places in the log, the period [s], and the counter with its modulus where there is one."""

    name: str
    places: npt.NDArray[np.intp]
    period: float
    counter: npt.NDArray[np.int64] | None
    modulus: int

    def around(self, place: int) -> tuple[int, int] | None:
        """Its last frame before `place` of the log and its first from there on, as numbers of its own."""
        after = int(np.searchsorted(self.places, place))
        return (after - 1, after) if 0 < after < len(self.places) else None

    def went_on(self, place: int) -> int | None:
        """Frames from the one to the other by the counter, round once at most."""
        ends = self.around(place)
        if self.counter is None or ends is None:
            return None
        return int((self.counter[ends[1]] - self.counter[ends[0]]) % self.modulus)


def on_one_clock(name: str, frames: Sequence[TimedFrame], known: Mapping[int, FrameLayout]) -> tuple[Samples, list[str]]:
    """The frames' times as if the clock had never been set, and what was found: a line each."""
    time = np.array([frame.time for frame in frames], dtype=float)
    streams = _streams(frames, time, known)
    if not streams:
        return time, []
    remarks = []
    for place in _suspects(time, min(stream.period for stream in streams)):
        step, by = _step(time, place, streams)
        if step:
            remarks.append(
                f"{name}: the clock was set {'forward' if step > 0 else 'back'} by {abs(step):.3g} s after frame {place} "
                f"({time[place - 1] - time[0]:.6g} s into the log); {by}"
            )
            time[place:] -= step
    return time, remarks


def _streams(frames: Sequence[TimedFrame], time: Samples, known: Mapping[int, FrameLayout]) -> list[_Stream]:
    places: dict[int, list[int]] = {}
    for place, frame in enumerate(frames):
        if frame.frame_id in known and known[frame.frame_id].fits(len(frame.data)):
            places.setdefault(frame.frame_id, []).append(place)
    found = []
    for identifier, where in places.items():
        steps = np.diff(time[where])
        if len(where) < 3 or not (steps > 0).any():
            continue
        layout, counter = known[identifier], None
        if layout.counter_bits:
            rows = [frames[place].data[: layout.length] for place in where]
            data = np.frombuffer(b"".join(rows), np.uint8).reshape(len(rows), layout.length)
            counter = layout.decode(data)[0]
        period = layout.sample_time * layout.samples or float(np.median(steps[steps > 0]))
        found.append(_Stream(layout.name, np.array(where), period, counter, 1 << layout.counter_bits))
    return found


def _suspects(time: Samples, period: float) -> list[int]:
    """Places in the log before which the clock may have been set."""
    steps = np.diff(time)
    back = np.flatnonzero(steps < -_DISORDER) + 1
    stays = [int(k) for k in back if k + 1 >= len(time) or time[k + 1] < time[k - 1]]
    pauses = np.flatnonzero(steps > max(_PAUSE * period, _LONG)) + 1
    return sorted({*stays, *map(int, pauses)})


def _step(time: Samples, place: int, streams: Sequence[_Stream]) -> tuple[float, str]:
    """By how much the clock was set before a place, 0 where it was not, and how that is known."""
    back = time[place] < time[place - 1]
    counted = [(stream, went) for stream in streams if (went := stream.went_on(place)) is not None]
    for stream, went in sorted(counted, key=lambda pair: pair[0].period):
        before, after = (stream.places[k] for k in stream.around(place) or (0, 0))
        elapsed = float(time[after] - time[before])
        off = (elapsed / stream.period - went + stream.modulus / 2) % stream.modulus - stream.modulus / 2
        agrees = abs(off) <= _OFF + _OFF_PART * abs(elapsed) / stream.period
        if back or (not agrees and went <= stream.modulus // 4):
            return elapsed - went * stream.period, f"bridged by the counter of {stream.name}"
        return 0.0, ""
    if not back:
        return 0.0, ""
    fastest = min((stream for stream in streams if stream.around(place)), key=lambda stream: stream.period, default=None)
    if fastest is None:
        return 0.0, ""
    before, after = (fastest.places[k] for k in fastest.around(place) or (0, 0))
    elapsed = float(time[after] - time[before])
    return elapsed - fastest.period, f"bridged by the period of {fastest.name}: frames lost in that moment cannot be seen"
