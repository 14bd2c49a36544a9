"""StreamBuffer: the newest samples of one stream, each at its number; what never came is NaN."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from residuum.identification.record import Record
from residuum.service.fieldbus.block import Block, Samples, StreamFormat


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
        if began_anew:
            self.breaks += self.end > self.first
            self.first = self.end = lowest
        if highest >= self.end:
            self._make_room(highest + 1)
            self._values[:, self.end - self.first : highest + 1 - self.first] = np.nan
            self.end = highest + 1
        kept = number >= self.first
        for row, name in enumerate(self._names):
            self._values[row, number[kept] - self.first] = block.channels[name][piece][kept]
        return began_anew

    def _make_room(self, end: int) -> None:
        if end - self.first <= self._values.shape[1]:
            return
        first = max(self.first, min(self.end, end - self._keep))
        held = self._values[:, first - self.first : self.end - self.first].copy()
        if end - first > self._values.shape[1]:
            self._values = np.full((len(self._names), 2 * (end - first)), np.nan, np.float32)
        self._values[:, : held.shape[1]] = held
        self.first = first

    def forget_before(self, number: int) -> None:
        """Nothing before this number is needed any more; the room is taken back when it is needed."""
        if number > self.first:
            number = min(number, self.end)
            held = self._values[:, number - self.first : self.end - self.first].copy()
            self._values[:, : held.shape[1]] = held
            self.first = number

    def channel(self, name: str, start: int, stop: int) -> npt.NDArray[np.float32]:
        """Samples `start` … `stop` − 1 of a channel (a view)."""
        return self._values[self._names.index(name), start - self.first : stop - self.first]

    def record(self, start: int, stop: int, source: str, leave_out: tuple[str, ...] = ()) -> Record:
        """Samples `start` … `stop` − 1 as a record (a copy); numbers outside the buffer are missing."""
        inside = slice(max(start, self.first), min(stop, self.end))
        channels = {}
        for name in self._names:
            if name not in leave_out:
                values = np.full(stop - start, np.nan, np.float32)
                if inside.stop > inside.start:
                    values[inside.start - start : inside.stop - start] = self.channel(name, inside.start, inside.stop)
                channels[name] = values
        units = {name: self.format.units[name] for name in channels}
        return Record(channels, units, self.format.sample_time, t0=start * self.format.sample_time, source=source)


def filled_forward(values: npt.NDArray[np.floating], before: float) -> Samples:
    """A two-valued or stepped signal with each missing sample taken as the one before it."""
    known = ~np.isnan(values)
    last = np.maximum.accumulate(np.where(known, np.arange(len(values)), -1))
    return np.where(last >= 0, values[np.maximum(last, 0)], before)
