"""Windows: how streams of samples are cut into the records that a diagnoser judges."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.service.fieldbus.block import Block, StreamFormat
from residuum.service.fieldbus.settings import WindowSettings
from residuum.service.machines.windows.round_windows import RoundCutter
from residuum.service.machines.windows.stream_buffer import StreamBuffer, filled_forward

_LATE = 0.05
_LONGEST_MOVEMENT = 60.0


class Cutter(ABC):
    """Takes blocks as they come and gives each window once it is complete.

    A window never reaches across a break of its stream; a hole inside it stays as missing samples, over which no diagnoser
    judges.
    """

    @abstractmethod
    def push(self, block: Block) -> Sequence[Record]:
        """Take samples; the windows that they complete."""


class MovementCutter(Cutter):
    """One window a movement: from the sample where `phase` leaves 0 (or changes) to the one where it changes again.

    A movement that was under way when the stream began is left out. One that lasts over a minute is cut there. Cutting runs
    50 ms behind, so that late frames can find their place.
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
    """Windows of `length` seconds every `step` seconds, beginning at multiples of the step on the stream's clock."""

    def __init__(self, format: StreamFormat, source: str, length: float, step: float) -> None:
        self._buffer = StreamBuffer(format, keep=length + 2 * step, longest_gap=length)
        self._length, self._step = (max(1, round(seconds / format.sample_time)) for seconds in (length, step))
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
    "sliding": lambda streams, window, source: SlidingCutter(_only(streams), source, window.length, window.step),
    "round": lambda streams, _, source: _RoundCutter(streams, source),
}
"""Kind of window → how to make its cutter from the machine's streams."""


def make_cutter(window: WindowSettings, streams: Sequence[StreamFormat], source: str) -> Cutter:
    """The cutter that the settings ask for; BadInput when the streams do not have what it needs."""
    return CUTTERS[window.cut]({stream.name: stream for stream in streams}, window, source)


def _only(streams: Mapping[str, StreamFormat]) -> StreamFormat:
    if len(streams) != 1:
        raise BadInput(f"sliding windows: need a source of one stream, not of several; there are {', '.join(streams) or 'none'}")
    return next(iter(streams.values()))
