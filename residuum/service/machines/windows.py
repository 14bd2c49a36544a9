"""Windows cut out of the streams of a machine, and those that are still kept."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from residuum.diagnosis.vibration.rotation import ClockAlignment, align_clocks, on_clock_of
from residuum.identification.errors import BadInput, BadRecord
from residuum.identification.physics.fmu.permission import is_packed
from residuum.identification.record import Record
from residuum.service.fieldbus.settings import WindowSettings
from residuum.service.fieldbus.source import Block, Samples, StreamFormat
from residuum.service.machines.adding import ModelText, model_signals, named
from residuum.service.storage.disk_store import DiskStore
from residuum.service.store import Conflict, SignalLetGo
from residuum.service.views.model_view import model_of

# Stored windows whose signals are still kept.


def kept_windows(
    store: DiskStore, asset: str, windows: Iterable[int]
) -> Iterator[tuple[int, Record]]:
    """Of these windows, in their order, each with its record; one whose signals were let go is
    passed over.
    """
    for window in windows:
        try:
            record = store.window_record(asset, window)
        except SignalLetGo:
            continue
        yield window, record


# Windows that a model can be held against: those without a hole in a signal that the model uses.


def complete_windows(
    store: DiskStore,
    asset: str,
    windows: Sequence[int],
    channels: Mapping[str, str],
    used: Collection[str],
    most: int,
) -> dict[int, Record]:
    """The newest of these windows without a hole, at most so many, oldest first; Conflict when each
    has one.

    A machine whose registers are polled loses a sample now and then; one such window must not stop
    a comparison.

    Parameters
    ----------
    channels : mapping of the model's names to the bus's
    used : collection of str
        Signals that the model uses, by its names.
    """
    complete: dict[int, Record] = {}
    for window, stored in kept_windows(store, asset, sorted(set(windows), reverse=True)):
        record = named(stored, channels)
        if not holed(record, used):
            complete[window] = record
        if len(complete) == most:
            break
    if not complete:
        raise Conflict(f"asset {asset!r}: none of {len(windows)} windows is complete; {REMEDY}")
    return dict(sorted(complete.items()))


REMEDY = (
    "samples of a signal that the model uses are missing: read less often (seconds between two"
    " reads), or record longer"
)


def holed(record: Record, used: Collection[str]) -> bool:
    """Whether a signal in use lacks a sample."""
    return any(record.missing(name).any() for name in record.names if name in used)


def used_by(model: ModelText | None) -> Collection[str]:
    """The signals that a model uses, by its names; none without a model."""
    if model is None:
        return ()
    name, text = model
    if is_packed(text):
        # loads what compiles, for FMUs alone
        from residuum.identification.physics.fmu.watched_model import (  # noqa: PLC0415
            signals_of,
        )

        return signals_of(text)
    return model_signals(model_of(name, text))


# StreamBuffer: the newest samples of one stream, each at its number; what never came is NaN.


class StreamBuffer:
    """Samples numbered `first` to `end` − 1 of one stream.

    Parameters
    ----------
    format : StreamFormat
    keep : float
        Seconds of history that a window may reach back.
    longest_gap : float
        A hole longer than this [s] begins the stream anew: what lies before is forgotten.
    """

    def __init__(self, format: StreamFormat, keep: float, longest_gap: float = 5.0) -> None:
        self.format = format
        self._names = list(format.units)
        self._keep = int(np.ceil(keep / format.sample_time))
        self._longest_gap = max(1, round(longest_gap / format.sample_time))
        self._values = np.full((len(self._names), 2 * self._keep), np.nan, np.float32)
        self.first = self.end = 0
        self.breaks = 0

    def add(self, block: Block) -> bool:
        """Put samples in their places; True when the stream began anew."""
        began_anew = False
        cuts = np.flatnonzero(np.diff(block.number) > self._longest_gap) + 1
        for piece in np.split(np.arange(block.n), cuts):
            if len(piece):
                began_anew |= self._add_piece(block, piece)
        return began_anew

    def _add_piece(self, block: Block, piece: npt.NDArray[np.intp]) -> bool:
        number = block.number[piece]
        lowest, highest = int(number.min()), int(number.max())
        began_anew = self.end == self.first or lowest > self.end + self._longest_gap
        # the first samples of all begin a stream, and break none
        if began_anew:
            self.breaks += self.end > self.first
            self.first = self.end = lowest
        if highest >= self.end:
            self._make_room(highest + 1)
            # missing until they come: the room may hold samples that were there before
            self._values[:, self.end - self.first : highest + 1 - self.first] = np.nan
            self.end = highest + 1
        # a late frame's place may be forgotten already
        held = number >= self.first
        for row, name in enumerate(self._names):
            self._values[row, number[held] - self.first] = block.channels[name][piece][held]
        return began_anew

    def _make_room(self, end: int) -> None:
        if end - self.first <= self._values.shape[1]:
            return
        # moved once every `keep` seconds, since the room is for twice as many samples
        first = max(self.first, min(self.end, end - self._keep))
        held = self._values[:, first - self.first : self.end - self.first].copy()
        if end - first > self._values.shape[1]:
            self._values = np.full((len(self._names), 2 * (end - first)), np.nan, np.float32)
        self._values[:, : held.shape[1]] = held
        self.first = first

    def forget_before(self, number: int) -> None:
        """Nothing before this number is needed any more; the room is taken back when it is
        needed.
        """
        if number > self.first:
            number = min(number, self.end)
            held = self._values[:, number - self.first : self.end - self.first].copy()
            self._values[:, : held.shape[1]] = held
            self.first = number

    def channel(self, name: str, start: int, stop: int) -> npt.NDArray[np.float32]:
        """Samples `start` … `stop` − 1 of a channel (a view)."""
        return self._values[self._names.index(name), start - self.first : stop - self.first]

    def record(self, start: int, stop: int, source: str, leave_out: tuple[str, ...] = ()) -> Record:
        """Samples `start` … `stop` − 1 as a record (a copy); numbers outside the buffer are
        missing.
        """
        inside = slice(max(start, self.first), min(stop, self.end))
        channels = {}
        for name in self._names:
            if name not in leave_out:
                values = np.full(stop - start, np.nan, np.float32)
                if inside.stop > inside.start:
                    values[inside.start - start : inside.stop - start] = self.channel(
                        name, inside.start, inside.stop
                    )
                channels[name] = values
        units = {name: self.format.units[name] for name in channels}
        return Record(
            channels,
            units,
            self.format.sample_time,
            # on the stream's own clock: windows of one stream can be put side by side
            t0=start * self.format.sample_time,
            source=source,
        )


def filled_forward(values: npt.NDArray[np.floating], before: float) -> Samples:
    """A two-valued or stepped signal with each missing sample taken as the one before it."""
    known = ~np.isnan(values)
    last = np.maximum.accumulate(np.where(known, np.arange(len(values)), -1))
    return np.where(last >= 0, values[np.maximum(last, 0)], before)


# Windows: how streams of samples are cut into the records that a diagnoser judges.

# RoundCutter: rounds of a rotating machine, out of a vibration stream and a machine stream with
# clocks of their own.

# Pulses of the indicator a round.
_QUADRANTS = 4
# Times the median width, from which on a pulse is the marking one.
_LONGER = 1.4
# [s] Without a marking pulse, after which a window is cut all the same.
_LONGEST_ROUND = 10.0
# [s] That both streams have to be ahead of a round: `_align` looks for pulses up to 1 s behind it.
_AFTER = 1.2
# [s] Before the end of a round whose pulses align the clocks.
_ALIGN_OVER = 30.0
# [s] Kept of each stream: the longest round, what its alignment looks back at, and what comes late.
_KEEP = 45.0
# [s] Of arrivals, before their offset is believed.
_ROUGH_OVER = 2.0
# [s] Of arrivals that the offset is the median of.
_ROUGH_KEPT = 10.0
# [s] Between the offset by pulses and the one by arrivals, from which on the pulses may be matched
# one round off.
_FAR_OFF = 0.6
# Rounds in a row that lie so far off before the alignment is given up: arrivals jitter.
_FAR_OFF_ROUNDS = 3


class EdgeFinder:
    """Pulses of a two-valued channel, found as the samples come.

    `rising` holds the times of rising edges on the stream's clock (half a sample before the first
    high sample), `pulses` their (first high sample, width in samples).
    """

    def __init__(self, buffer: StreamBuffer, channel: str) -> None:
        self._buffer, self._channel = buffer, channel
        self._late = max(1, round(_LATE / buffer.format.sample_time))
        self.begin_anew()

    def begin_anew(self) -> None:
        """Forget everything: the stream has begun anew."""
        self.rising: deque[float] = deque(maxlen=256)
        self.pulses: deque[tuple[int, int]] = deque(maxlen=256)
        self._looked_at = self._buffer.first
        self._level = float("nan")
        self._high_since: int | None = None

    def look(self) -> None:
        """Find the edges in what has come since."""
        begin, end = max(self._looked_at, self._buffer.first), self._buffer.end - self._late
        if end <= begin:
            return
        level = filled_forward(self._buffer.channel(self._channel, begin, end), self._level) > 0.5
        # a stream that begins high shows no edge
        before = bool(level[0]) if np.isnan(self._level) else self._level > 0.5
        for step in np.flatnonzero(np.diff(np.concatenate([[before], level]))).tolist():
            self._edge(begin + step, bool(level[step]))
        self._level, self._looked_at = float(level[-1]), end

    def _edge(self, at: int, up: bool) -> None:
        if up:
            self._high_since = at
            self.rising.append((at - 0.5) * self._buffer.format.sample_time)
        elif self._high_since is not None:
            self.pulses.append((self._high_since, at - self._high_since))
            self._high_since = None


class RoundCutter:
    """One window a round, on the vibration stream's clock, with the machine's signals held on it.

    A round runs from one marking pulse of `indicator` to the next: the pulse longer than the
    others, or every fourth one when none is longer. The clocks are aligned by the pulses that both
    streams have in `sync`; which pulse belongs to which is decided once by when samples arrived,
    and watched from then on. When no marking pulse has come for ten seconds, those ten seconds are
    a window of their own (whatever is judged of it, it says that the indicator is dead).

    Parameters
    ----------
    streams : mapping of name to StreamFormat
        One stream with `sync` and `indicator`, and one with `sync` and without.
    source : str

    Raises
    ------
    BadInput
        The streams do not have these channels.
    """

    def __init__(self, streams: Mapping[str, StreamFormat], source: str) -> None:
        machine = [
            stream for stream in streams.values() if {"sync", "indicator"} <= set(stream.units)
        ]
        vibration = [
            stream
            for stream in streams.values()
            if "sync" in stream.units and "indicator" not in stream.units
        ]
        if len(machine) != 1 or len(vibration) != 1:
            raise BadInput(
                "windows by round: need one stream with sync and indicator and one with sync and"
                " without indicator"
            )
        self._machine, self._vibration = (
            StreamBuffer(machine[0], _KEEP),
            StreamBuffer(vibration[0], _KEEP),
        )
        self._indicator = EdgeFinder(self._machine, "indicator")
        self._machine_sync, self._vibration_sync = (
            EdgeFinder(self._machine, "sync"),
            EdgeFinder(self._vibration, "sync"),
        )
        self._source = source
        self._begin_anew()

    def _begin_anew(self) -> None:
        for finder in (self._indicator, self._machine_sync, self._vibration_sync):
            finder.begin_anew()
        self._rough: deque[tuple[float, float]] = deque()
        self._alignment: ClockAlignment | None = None
        self._far_off = 0
        self._start: int | None = None

    def push(self, block: Block) -> Sequence[Record]:
        """Take samples of either stream; the rounds that they complete."""
        buffer = self._machine if block.stream == self._machine.format.name else self._vibration
        if buffer.add(block):
            self._begin_anew()
        for finder in (self._indicator, self._machine_sync, self._vibration_sync):
            finder.look()
        self._note_arrival()
        windows = []
        while (stop := self._next_mark()) is not None and self._arrived(stop):
            window = self._cut(stop)
            if window is None:
                break
            windows.append(window)
        return windows

    def _note_arrival(self) -> None:
        """Remember how the two clocks read at the same moment, to within the time that samples are
        under way.
        """
        if self._machine.end == self._machine.first or self._vibration.end == self._vibration.first:
            return
        # the newest sample of each came at about this moment, so their clocks differ by about this
        reference = self._vibration.end * self._vibration.format.sample_time
        machine_time = self._machine.end * self._machine.format.sample_time
        self._rough.append((reference, reference - machine_time))
        while self._rough[0][0] < reference - _ROUGH_KEPT:
            self._rough.popleft()

    def _rough_offset(self) -> float | None:
        if not self._rough or self._rough[-1][0] - self._rough[0][0] < _ROUGH_OVER:
            return None
        return float(np.median([offset for _, offset in self._rough]))

    def _next_mark(self) -> int | None:
        """The first sample (machine clock) after the open round; opens the first round on the
        way.
        """
        while True:
            mark = self._mark_after(self._start)
            if self._start is not None or mark is None:
                return mark
            self._start = mark

    def _mark_after(self, start: int | None) -> int | None:
        """The first marking pulse after `start`, or what stands for it where none has come for ten
        seconds.
        """
        pulses = list(self._indicator.pulses)
        marks = _longer_pulses(pulses)
        fourth = not marks
        # too few pulses to tell whether one of them is longer: the first round waits for more
        if fourth and start is None and len(pulses) <= _QUADRANTS:
            return None
        if fourth:
            marks = [at for at, _ in pulses]
        if start is not None:
            marks = [at for at in marks if at > start]
            marks = marks[_QUADRANTS - 1 :] if fourth else marks
        return marks[0] if marks else self._silent_until(start)

    def _silent_until(self, start: int | None) -> int | None:
        longest = _LONGEST_ROUND / self._machine.format.sample_time
        if start is None or self._machine.end - start <= longest:
            return None
        return start + round(longest)

    def _arrived(self, stop: int) -> bool:
        """Whether both streams have come far enough beyond the round to be aligned there."""
        rough = self._rough_offset()
        if rough is None:
            return False
        end = stop * self._machine.format.sample_time + _AFTER
        machine_end = self._machine.end * self._machine.format.sample_time
        vibration_end = self._vibration.end * self._vibration.format.sample_time
        offset = self._alignment.offset if self._alignment else rough
        return machine_end >= end and vibration_end >= end + offset

    def _cut(self, stop: int) -> Record | None:
        start, self._start = self._start, stop
        if start is None:
            return None
        alignment = self._align(stop * self._machine.format.sample_time)
        if alignment is None:
            return None
        Ts_machine, Ts = self._machine.format.sample_time, self._vibration.format.sample_time
        begin, end = (
            int(np.ceil(alignment.to_reference(at * Ts_machine) / Ts)) for at in (start, stop)
        )
        # the machine's signals are held on the vibration's clock: some before and after are needed
        spare = round(1.0 / Ts_machine)
        machine = self._machine.record(
            start - spare, stop + spare, self._source, leave_out=("sync",)
        )
        vibration = self._vibration.record(begin, end, self._source, leave_out=("sync",))
        return on_clock_of(vibration, machine, alignment)

    def _align(self, stop: float) -> ClockAlignment | None:
        rough = self._rough_offset()
        expected = self._alignment.offset if self._alignment else rough
        if expected is None or rough is None:
            return None
        since, until = stop - _ALIGN_OVER, stop + 1.0
        machine_pulses = [t for t in self._machine_sync.rising if since <= t <= until]
        reference = [
            t for t in self._vibration_sync.rising if since - 1.0 <= t - expected <= until + 1.0
        ]
        try:
            self._alignment = align_clocks(reference, machine_pulses, expected)
        except BadRecord:
            self._alignment = None
            return None
        self._far_off = self._far_off + 1 if abs(self._alignment.offset - rough) > _FAR_OFF else 0
        if self._far_off >= _FAR_OFF_ROUNDS:
            self._alignment, self._far_off = None, 0
        return self._alignment


def _longer_pulses(pulses: Sequence[tuple[int, int]]) -> list[int]:
    """First samples of the pulses longer than the others, once there are enough to tell."""
    if len(pulses) <= _QUADRANTS:
        return []
    # over the last four rounds: the machine may turn faster or slower than before
    median = np.median([width for _, width in pulses[-_QUADRANTS * 4 :]])
    return [at for at, width in pulses if width > _LONGER * median]


# [s] That cutting runs behind what came: late frames find their place.
_LATE = 0.05
# [s] After which a movement is cut: a signal that stays off 0 must not fill the memory.
_LONGEST_MOVEMENT = 60.0


class Cutter(ABC):
    """Takes blocks as they come and gives each window once it is complete.

    A window never reaches across a break of its stream; a hole inside it stays as missing samples,
    over which no diagnoser judges.
    """

    @abstractmethod
    def push(self, block: Block) -> Sequence[Record]:
        """Take samples; the windows that they complete."""


class MovementCutter(Cutter):
    """One window a movement: from the sample where `phase` leaves 0 (or changes) to the one where
    it changes again.

    A movement that was under way when the stream began is left out. One that lasts over a minute is
    cut there. Cutting runs 50 ms behind, so that late frames can find their place.
    """

    def __init__(self, format: StreamFormat, source: str) -> None:
        if "phase" not in format.units:
            raise BadInput(f"windows by movement: stream {format.name!r} has no channel 'phase'")
        self._buffer = StreamBuffer(format, keep=_LONGEST_MOVEMENT + 10.0)
        self._late = max(1, round(_LATE / format.sample_time))
        self._longest = round(_LONGEST_MOVEMENT / format.sample_time)
        self._source = source
        self._begin_anew()

    def _begin_anew(self) -> None:
        self._looked_at = self._buffer.first
        self._phase: float | None = None
        self._start: int | None = None

    def push(self, block: Block) -> Sequence[Record]:
        """Take samples; the movements that they complete."""
        if self._buffer.add(block):
            self._begin_anew()
        begin, end = max(self._looked_at, self._buffer.first), self._buffer.end - self._late
        if end <= begin:
            return []
        values = self._buffer.channel("phase", begin, end)
        before = self._phase if self._phase is not None else float("nan")
        phase = filled_forward(values, before)
        steps = np.flatnonzero(np.diff(np.concatenate([[before], phase])) != 0)
        windows = []
        # a step from what is not known is none: the movement was under way, or the stream begins
        for step in steps.tolist():
            if not np.isnan(before if step == 0 else phase[step - 1]):
                windows += self._change(begin + step, float(phase[step]))
        self._phase, self._looked_at = float(phase[-1]), end
        if self._start is not None and end - self._start > self._longest:
            windows.append(self._window(self._start, self._start + self._longest))
            self._start = None
        self._buffer.forget_before(end if self._start is None else self._start)
        return windows

    def _change(self, at: int, phase: float) -> list[Record]:
        windows = [] if self._start is None else [self._window(self._start, at)]
        self._start = at if phase != 0 else None
        return windows

    def _window(self, start: int, stop: int) -> Record:
        return self._buffer.record(start, stop, self._source)


class SlidingCutter(Cutter):
    """Windows of `length` seconds every `step` seconds, beginning at multiples of the step on the
    stream's clock.
    """

    def __init__(self, format: StreamFormat, source: str, length: float, step: float) -> None:
        self._buffer = StreamBuffer(format, keep=length + 2 * step, longest_gap=length)
        self._length, self._step = (
            max(1, round(seconds / format.sample_time)) for seconds in (length, step)
        )
        self._source = source
        self._next: int | None = None

    def push(self, block: Block) -> Sequence[Record]:
        """Take samples; the windows that they complete."""
        if self._buffer.add(block) or self._next is None:
            self._next = -(-self._buffer.first // self._step) * self._step
        windows = []
        while self._buffer.end >= self._next + self._length:
            windows.append(self._buffer.record(self._next, self._next + self._length, self._source))
            self._next += self._step
        self._buffer.forget_before(min(self._next, self._buffer.end))
        return windows


class _RoundCutter(RoundCutter, Cutter):
    """The round cutter, one of the family."""


CUTTERS: dict[str, Callable[[Mapping[str, StreamFormat], WindowSettings, str], Cutter]] = {
    "movement": lambda streams, _, source: MovementCutter(_only(streams), source),
    "sliding": lambda streams, window, source: SlidingCutter(
        _only(streams), source, window.length, window.step
    ),
    "round": lambda streams, _, source: _RoundCutter(streams, source),
}
"""Kind of window → how to make its cutter from the machine's streams."""


def make_cutter(window: WindowSettings, streams: Sequence[StreamFormat], source: str) -> Cutter:
    """The cutter that the settings ask for; BadInput when the streams do not have what it needs."""
    return CUTTERS[window.cut]({stream.name: stream for stream in streams}, window, source)


def _only(streams: Mapping[str, StreamFormat]) -> StreamFormat:
    if len(streams) != 1:
        raise BadInput(
            "sliding windows: need a source of one stream, not of several; there are"
            f" {', '.join(streams) or 'none'}"
        )
    return next(iter(streams.values()))
