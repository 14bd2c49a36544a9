"""LoggedMessage: the frames of one message in a CAN log, each with its place on the message's own
even clock.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from residuum.service.fieldbus.can.can_log import CanLog, TimedFrame
from residuum.service.fieldbus.can.frame_batch import EXTENDED
from residuum.service.fieldbus.can.frame_layout import (
    BadBusDescription,
    BusMessages,
    Bytes,
    FrameLayout,
    source_of,
)
from residuum.service.fieldbus.can.frame_matching import FrameMatching, several_sources
from residuum.service.fieldbus.source import Numbers, Samples

# Part by which the time between frames may differ from the DBC file's and still be taken for it.
_SAME_TIME = 0.01
# Of all steps that are zero, from which on stamps do not tell frames apart.
_SHARED = 0.2
# Frames by which time stamps may be off what the counter says, beside a quarter of the time between
# two frames.
_LATE = 2.0


@dataclass(frozen=True, eq=False)
class LoggedMessage:
    """Frames of one message, in their order and each once.

    Parameters
    ----------
    layout : FrameLayout
    time : float array, shape (n,)
        When each was seen [s].
    frames : uint8 array, shape (n, length)
    number : int64 array, shape (n,)
        Place on the message's clock; a hole is a loss.
    frame_time : float
        Seconds between two frames.
    jitter : float
        How far time stamps lie off the even clock at most, in frames.
    remarks : sequence of str
    placed : bool
        Whether something else than the time stamps gives the places: a counter, or the order of
        frames that share stamps.
    """

    layout: FrameLayout
    time: Samples
    frames: Bytes
    number: Numbers
    frame_time: float
    jitter: float
    remarks: Sequence[str]
    placed: bool = False

    @property
    def lost(self) -> int | None:
        """Frames that the counter says were sent and that are not in the log; None without a
        counter.
        """
        return (
            int(self.number[-1] - self.number[0] + 1 - len(self.number))
            if self.layout.counter_bits
            else None
        )

    @property
    def begin(self) -> float:
        """Time of the first sample of the first frame on the even clock [s]."""
        clock = self.time - self.frame_time * (self.number - self.number[0])
        return float(np.median(clock)) - (self.layout.samples - 1) * self.sample_time

    @property
    def sample_time(self) -> float:
        """Seconds between samples."""
        return self.frame_time / self.layout.samples


def logged_messages(
    log: CanLog, messages: BusMessages
) -> tuple[list[LoggedMessage], dict[str, int]]:
    """The messages of a DBC file that a log holds at least twice, and how often each other
    identifier is there.

    Raises BadBusDescription when a message is on several buses of the log: which one is meant is
    not guessed.
    """
    known = FrameMatching(messages.values())
    time, set_clock = on_one_clock(log.name, log.frames, known)
    by_sender: dict[int, list[TimedFrame]] = {}
    for frame, instant in zip(log.frames, time, strict=True):
        by_sender.setdefault(known.sender(frame.frame_id), []).append(
            frame._replace(time=float(instant))
        )
    logged, unused = [], {}
    others = _other_sources(known, by_sender)
    for sender, frames in by_sender.items():
        layout, identifier = known.get(sender), frames[0].frame_id
        if sender in others:
            unused[f"{_shown(identifier)} ({others[sender]})"] = len(frames)
            continue
        fitting = [] if layout is None else _of_layout(layout, frames)
        # one frame alone has no time to a next one, and so no clock
        if layout is not None and len(fitting) > 1:
            logged.append(_logged(log.name, layout, fitting, len(frames) - len(fitting)))
        else:
            unused[_shown(identifier)] = len(frames)
    # the clock is the whole log's: what is said of it stands once, before all else
    if logged and set_clock:
        logged[0] = replace(logged[0], remarks=[*set_clock, *logged[0].remarks])
    return logged, unused


def _other_sources(known: FrameMatching, senders: Iterable[int]) -> dict[int, str]:
    """Senders of J1939 messages that are not read, and why: another device is meant, or of several
    nothing says which one.
    """
    # by the message that they are of, which stands once in the file
    senders_of: dict[FrameLayout, list[int]] = {}
    for sender in senders:
        layout = known.get(sender)
        if layout is not None and layout.is_j1939 and layout.source_address is None:
            senders_of.setdefault(layout, []).append(sender)
    others: dict[int, str] = {}
    for layout, found in senders_of.items():
        if len(found) > 1:
            others |= _not_meant(layout, found)
    return others


def _not_meant(layout: FrameLayout, senders: Sequence[int]) -> dict[int, str]:
    sources = [source_of(sender) for sender in senders]
    says = several_sources(layout, sources)
    if layout.own_source in sources:
        says = f"message {layout.name}: source address 0x{layout.own_source:02X} is read"
    return {
        sender: says
        for sender, source in zip(senders, sources, strict=True)
        if source != layout.own_source
    }


def _of_layout(layout: FrameLayout, frames: Sequence[TimedFrame]) -> list[TimedFrame]:
    return [frame for frame in frames if layout.fits(len(frame.data))]


def _shown(identifier: int) -> str:
    """An identifier as loggers write it: hexadecimal, with an x behind an extended one."""
    return f"0x{identifier & ~EXTENDED:X}{'x' if identifier & EXTENDED else ''}"


def _bytes_of(layout: FrameLayout, frames: Sequence[TimedFrame]) -> Bytes:
    """The frames' bytes, shape (n, length), without those that CAN FD fills a frame up with."""
    joined = b"".join(frame.data[: layout.length] for frame in frames)
    return np.frombuffer(joined, np.uint8).reshape(len(frames), layout.length)


def _logged(
    name: str, layout: FrameLayout, frames: Sequence[TimedFrame], misfits: int
) -> LoggedMessage:
    """One message of a log; `misfits` frames of its identifier were of another length."""
    where = f"{name}, message {layout.name}"
    buses = {frame.bus for frame in frames}
    if len(buses) > 1:
        raise BadBusDescription(
            f"{where}: is on the buses {', '.join(sorted(buses))} of the log; export one bus alone"
        )
    notes = []
    if misfits:
        notes.append(f"{misfits} frames have another length than {layout.length} bytes, left out")

    # places first: what came twice, what was lost, and how even the stamps are follows from them
    time, data = np.array([frame.time for frame in frames]), _bytes_of(layout, frames)
    placing = _placing(layout, time, data)
    notes += placing.notes
    number = placing.number

    # in the order of places, and of frames that came twice the first
    order = np.unique(number, return_index=True)[1]
    if len(order) < len(number):
        notes.append(f"{len(number) - len(order)} frames came twice, used once")
    number, time, data = number[order] - number[order[0]], time[order], data[order]

    frame_time, differs = _settled(layout, placing.frame_time)
    notes += differs
    off = (time - frame_time * number) / frame_time
    jitter = float(np.ptp(off) / 2)
    if layout.counter_bits:
        notes += _counted_notes(number, jitter)
    remarks = [f"{where}: {note}" for note in notes]
    return LoggedMessage(
        layout, time, data, number, frame_time, jitter, remarks, not placing.by_stamps
    )


class _Placing(NamedTuple):
    """Places of frames on their message's clock, seconds between two of them, whether time stamps
    alone gave the places, and what is to be said of it.
    """

    number: Numbers
    frame_time: float
    by_stamps: bool
    notes: list[str]


def _placing(layout: FrameLayout, time: Samples, data: Bytes) -> _Placing:
    """Places by the best that there is: a counter, else the order of frames that share stamps, else
    the stamps.
    """
    if layout.counter_bits:
        number, frame_time, jumps = _by_counter(layout, time, layout.decode(data)[0])
        jumped = f"the counter jumped {jumps} times, placed by time stamps there"
        return _Placing(number, frame_time, False, [jumped] if jumps else [])
    spread = _spread(layout, time)
    if spread is None:
        number, frame_time = _by_time(time, data)
        return _Placing(number, frame_time, True, [layout.remark])
    number, frame_time = spread
    shared = f"several frames share a stamp; placed in their order, one every {frame_time:.6g} s"
    return _Placing(number, frame_time, False, [layout.remark, shared])


def _counted_notes(number: Numbers, jitter: float) -> list[str]:
    """What a counter shows: frames lost, and stamps that disagree with it."""
    notes = []
    lost = int(number[-1]) + 1 - len(number)
    if lost:
        notes.append(f"{lost} frames lost, their samples are missing")
    # by more than a frame the stamps would have given other places
    if jitter > 1.0:
        notes.append(
            f"time stamps lie up to {jitter:.3g} frames off its even clock; the counter gives the"
            " places"
        )
    return notes


def _by_counter(
    layout: FrameLayout, time: Samples, counter: npt.NDArray[np.int64]
) -> tuple[Numbers, float, int]:
    """Places by the counter, unwrapped by the time stamps; time between frames; how often the
    counter jumped.
    """
    modulus = 1 << layout.counter_bits
    counted, elapsed = np.diff(counter) % modulus, np.diff(time)
    # the time between frames from those that follow each other by the counter: losses do not count
    following = elapsed[(counted == 1) & (elapsed > 0)]
    frame_time = float(np.median(following)) if len(following) else _typical(time)
    # step = counted + modulus · turns, with the turns that the stamps are nearest to
    expected = elapsed / frame_time
    step = counted + modulus * np.rint((expected - counted) / modulus).astype(np.int64)
    # what rounding leaves is at most half a modulus; more than a quarter is no late stamp: the
    # counter began anew
    jumped = np.abs(step - expected) > np.maximum(_LATE, 0.25 * modulus)
    step = np.where(jumped, np.maximum(1, np.rint(expected)), step).astype(np.int64)
    number = np.concatenate([[0], np.cumsum(step)]).astype(np.int64)
    return number, _slope(time, number, frame_time), int(jumped.sum())


def _spread(layout: FrameLayout, time: Samples) -> tuple[Numbers, float] | None:
    """Places of frames of which several share a stamp, one after the other by the DBC file's time;
    None where stamps tell.

    A logger that stamps by transfers, or whose clock is coarse, gives equal stamps to frames that
    are not the same. A place is left free only where the stamps are further on than that can
    explain.
    """
    due, steps = layout.sample_time * layout.samples, np.diff(time)
    if not due or np.count_nonzero(steps == 0) < _SHARED * len(steps) or not (steps > 0).any():
        return None
    # a stamp may be late by the clock's grain, in whole frames; 0.01 keeps a grain of exactly k
    # frames from becoming k + 1 by rounding
    slack = float(np.ceil(np.median(steps[steps > 0]) / due - 0.01))
    least = np.rint((time - time[0]) / due - slack).astype(np.int64)
    # place k = k + the largest delay that any stamp up to k proves
    places = np.arange(len(time))
    return np.maximum.accumulate(least - places).clip(0) + places, due


def _by_time(time: Samples, data: Bytes) -> tuple[Numbers, float]:
    """Places by the time stamps alone, and the time between frames; only what is the same can have
    come twice.
    """
    frame_time = _typical(time)
    step = np.maximum(np.rint(np.diff(time) / frame_time), 0).astype(np.int64)
    # frames of one place that differ cannot be one frame twice: the second has a place of its own
    differs = np.any(data[1:] != data[:-1], axis=1)
    for k in np.flatnonzero((step == 0) & differs):
        step[k] = 1
        if k + 1 < len(step) and step[k + 1] > 1:  # the one before was late, this one is not
            step[k + 1] -= 1
    number = np.concatenate([[0], np.cumsum(step)]).astype(np.int64)
    return number, _slope(time, number, frame_time)


def _typical(time: Samples) -> float:
    steps = np.diff(time)
    return float(np.median(steps[steps > 0])) if (steps > 0).any() else 1.0


def _slope(time: Samples, number: Numbers, otherwise: float) -> float:
    """Seconds a place, over the whole log."""
    span = number[-1] - number[0]
    return float((time[-1] - time[0]) / span) if span > 0 and time[-1] > time[0] else otherwise


def _settled(layout: FrameLayout, period: float) -> tuple[float, list[str]]:
    """The time between frames: what the DBC file says where the log agrees to 1 %, else what the
    log shows.
    """
    due = layout.sample_time * layout.samples
    if not due:
        return period, []
    if abs(period - due) <= _SAME_TIME * due:
        return due, []
    return period, [f"a frame every {period:.6g} s, the DBC file says {due:.6g} s"]


# The clock of a CAN log: where it was set while frames went on coming, and by how much.
#
# A step back is seen in the order of the frames: two in a row before one that came earlier. A step
# forward looks like a pause, and is told from one where the counters go on as if nothing had been
# lost; one of an hour is as good as a pause, for a counter goes round too often meanwhile. What
# lies on both sides is brought together by the counters, else by the period of the fastest message,
# which takes for granted that nothing was lost in that moment.

# Seconds by which frames of several buses may stand in another order than they came.
_DISORDER = 1e-3
# Periods of the fastest message, and seconds, from which on a pause may be a clock that was set.
_PAUSE, _LONG = 20.0, 0.3
# Frames, and the part of a pause, by which a counter and the clock may differ.
_OFF, _OFF_PART = 2.0, 0.005


@dataclass(frozen=True, eq=False)
class _Stream:
    """The frames of one message: their places in the log, the period [s], and the counter with its
    modulus where there is one.
    """

    name: str
    places: npt.NDArray[np.intp]
    period: float
    counter: npt.NDArray[np.int64] | None
    modulus: int

    def around(self, place: int) -> tuple[int, int] | None:
        """Its last frame before `place` of the log and its first from there on, as numbers of its
        own.
        """
        after = int(np.searchsorted(self.places, place))
        return (after - 1, after) if 0 < after < len(self.places) else None

    def elapsed(self, time: Samples, place: int) -> float:
        """Seconds from the one to the other by the log's clock."""
        before, after = (self.places[k] for k in self.around(place) or (0, 0))
        return float(time[after] - time[before])

    def went_on(self, place: int) -> int | None:
        """Frames from the one to the other by the counter, round once at most."""
        ends = self.around(place)
        if self.counter is None or ends is None:
            return None
        return int((self.counter[ends[1]] - self.counter[ends[0]]) % self.modulus)


def on_one_clock(
    name: str, frames: Sequence[TimedFrame], known: FrameMatching
) -> tuple[Samples, list[str]]:
    """The frames' times as if the clock had never been set, and what was found: a line each."""
    time = np.array([frame.time for frame in frames], dtype=float)
    streams = _streams(frames, time, known)
    if not streams:
        return time, []
    remarks = []
    # in order: each correction moves all that follows, and so what the next suspect is judged by
    for place in _suspects(time, min(stream.period for stream in streams)):
        step, by = _step(time, place, streams)
        if step:
            remarks.append(
                f"{name}: the clock was set {'forward' if step > 0 else 'back'} by {abs(step):.3g}"
                f" s after frame {place} ({time[place - 1] - time[0]:.6g} s into the log); {by}"
            )
            time[place:] -= step
    return time, remarks


def _streams(frames: Sequence[TimedFrame], time: Samples, known: FrameMatching) -> list[_Stream]:
    places: dict[int, list[int]] = {}
    for place, frame in enumerate(frames):
        layout = known.get(frame.frame_id)
        if layout is not None and layout.fits(len(frame.data)):
            places.setdefault(known.sender(frame.frame_id), []).append(place)
    streams = []
    for sender, where in places.items():
        steps = np.diff(time[where])
        layout = known.get(sender)
        # two frames have one step, which the clock itself may have made
        if layout is not None and len(where) > 2 and (steps > 0).any():
            of_sender = [frames[place] for place in where]
            streams.append(_stream(layout, np.array(where), of_sender, steps))
    return streams


def _stream(
    layout: FrameLayout,
    places: npt.NDArray[np.intp],
    frames: Sequence[TimedFrame],
    steps: Samples,
) -> _Stream:
    counter = layout.decode(_bytes_of(layout, frames))[0] if layout.counter_bits else None
    period = layout.sample_time * layout.samples or float(np.median(steps[steps > 0]))
    return _Stream(layout.name, places, period, counter, 1 << layout.counter_bits)


def _suspects(time: Samples, period: float) -> list[int]:
    """Places in the log before which the clock may have been set."""
    steps = np.diff(time)
    # one frame that is late alone is disorder: a clock that was set back keeps the next one back,
    # too
    back = np.flatnonzero(steps < -_DISORDER) + 1
    stays = [int(k) for k in back if k + 1 >= len(time) or time[k + 1] < time[k - 1]]
    pauses = np.flatnonzero(steps > max(_PAUSE * period, _LONG)) + 1
    return sorted({*stays, *map(int, pauses)})


def _step(time: Samples, place: int, streams: Sequence[_Stream]) -> tuple[float, str]:
    """By how much the clock was set before a place, 0 where it was not, and how that is known."""
    back = bool(time[place] < time[place - 1])
    on_both_sides = [stream for stream in streams if stream.around(place)]
    counted = [stream for stream in on_both_sides if stream.counter is not None]
    # the fastest stream has its frames nearest to the place, and so the least to bridge
    if counted:
        return _step_by_counter(time, place, min(counted, key=_period), back)
    # without a counter a step forward cannot be told from a pause
    if not back or not on_both_sides:
        return 0.0, ""
    fastest = min(on_both_sides, key=_period)
    return (
        fastest.elapsed(time, place) - fastest.period,
        f"bridged by the period of {fastest.name}: frames lost in that moment cannot be seen",
    )


def _period(stream: _Stream) -> float:
    return stream.period


def _step_by_counter(time: Samples, place: int, stream: _Stream, back: bool) -> tuple[float, str]:
    """The step that a message's counter proves: elapsed time less that of the frames it counted."""
    elapsed, went = stream.elapsed(time, place), stream.went_on(place) or 0
    # the counter knows frames only up to whole turns: the difference is taken within half a turn
    half = stream.modulus / 2
    off = (elapsed / stream.period - went + half) % stream.modulus - half
    agrees = abs(off) <= _OFF + _OFF_PART * abs(elapsed) / stream.period
    # forward only where the counter went on by little: after more it may have gone round unseen
    if back or (not agrees and went <= stream.modulus // 4):
        return elapsed - went * stream.period, f"bridged by the counter of {stream.name}"
    return 0.0, ""
