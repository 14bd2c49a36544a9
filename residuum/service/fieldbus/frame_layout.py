"""FrameLayout: where the signals of a CAN frame lie, from a DBC file; decodes and encodes many frames at once with NumPy.

A frame that carries samples has a sequence counter and the message attribute `SampleTime` [s] or `GenMsgCycleTime` [ms]. The
counter is the signal `counter`, else the only one that is called like an alive, rolling, message or sequence counter.
Signals named `x_00`, `x_01`, … are successive samples of one channel `x`; any other signal is a channel of its own with one
sample a frame.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from cantools.database import load_file
from cantools.database.can.database import Database
from cantools.database.errors import Error as DatabaseError

from residuum.identification.errors import BadInput
from residuum.service.fieldbus.block import Samples, StreamFormat

Bytes = npt.NDArray[np.uint8]
COUNTER = "counter"
_COUNTER_LIKE = re.compile(r"(.*_)?(alive|rolling|message|msg|sequence|seq|frame)_?(counter|count|cnt)", re.IGNORECASE)
_INDEXED = re.compile(r"^(?P<channel>.+)_(?P<index>\d{2,})$")


class BadBusDescription(BadInput):
    """A DBC file or register map cannot be used; the message names the file, the place and the rule."""


class FrameLayout:
    """Bit positions, scales and units of the signals of one CAN message.

    Parameters
    ----------
    message : cantools message
    where : str
        File name for messages.

    Raises
    ------
    BadBusDescription
        A signal that spans more than 8 bytes, blocks of unequal length, a counter that is not 4 to 32 bits wide.
    """

    def __init__(self, message: Any, where: str) -> None:
        self.name: str = message.name
        self.frame_id: int = message.frame_id
        self.is_extended: bool = message.is_extended_frame
        self.is_fd: bool = message.length > 8
        self.length: int = message.length
        where = f"{where}, message {message.name}"
        signals = list(message.signals)
        self._names = [signal.name for signal in signals]
        self._set_positions(signals, where)
        self._scale = np.array([float(signal.conversion.scale) for signal in signals])
        self._offset = np.array([float(signal.conversion.offset) for signal in signals])
        self._signed = np.array([signal.is_signed for signal in signals])
        self._floats = [(k, signal.length) for k, signal in enumerate(signals) if signal.conversion.is_float]
        self.choices: dict[str, dict[int, str]] = {
            signal.name: {int(key): str(value) for key, value in (signal.choices or {}).items()} for signal in signals
        }
        self._group(signals, where)
        self.sample_time = _frame_time(message) / self.samples if self.counter_bits else 0.0

    def _set_positions(self, signals: list[Any], where: str) -> None:
        spans = [_span(signal.start, signal.length, signal.byte_order) for signal in signals]
        width = max(len(order) for order, _ in spans)
        if width > 8:
            raise BadBusDescription(f"{where}: a signal spans {width} bytes; at most 8 are supported")
        self._bits = np.array([signal.length for signal in signals], np.uint64)
        self._right = np.array([shift for _, shift in spans], np.uint64)
        self._index = np.zeros((len(signals), width), np.intp)
        self._weight = np.zeros((len(signals), width), np.uint64)
        self._left = np.zeros((len(signals), width), np.uint64)
        for k, (order, _) in enumerate(spans):
            for j, byte in enumerate(reversed(order)):
                self._index[k, j], self._weight[k, j], self._left[k, j] = byte, 1, 8 * j
        self._mask = np.where(
            self._bits == 64, np.uint64(0xFFFFFFFFFFFFFFFF), (np.uint64(1) << (self._bits % np.uint64(64))) - np.uint64(1)
        )

    def _group(self, signals: list[Any], where: str) -> None:
        groups: dict[str, list[tuple[int, int]]] = {}
        self.counter_bits = 0
        counter = _counter_of(self._names)
        for k, signal in enumerate(signals):
            if signal.name == counter:
                self.counter_bits, self._counter = signal.length, k
                if not 4 <= signal.length <= 32:
                    raise BadBusDescription(f"{where}: the counter has {signal.length} bits; 4 to 32 are needed")
                continue
            indexed = _INDEXED.match(signal.name)
            name, index = (indexed["channel"], int(indexed["index"])) if indexed else (signal.name, 0)
            groups.setdefault(name, []).append((index, k))
        self._channels = {name: np.array([k for _, k in sorted(members)]) for name, members in groups.items()}
        lengths = {len(members) for members in self._channels.values()}
        if len(lengths) != 1:
            raise BadBusDescription(f"{where}: channels have {sorted(lengths)} samples a frame; all must have the same number")
        self.samples = lengths.pop()
        self.units = {name: signals[members[0]].unit or "" for name, members in self._channels.items()}

    @property
    def format(self) -> StreamFormat:
        """The stream that these frames carry; BadBusDescription for a frame without a counter."""
        if not self.counter_bits:
            raise BadBusDescription(f"message {self.name}: has no signal {COUNTER!r}; a stream of samples needs one")
        return StreamFormat(self.name, self.sample_time, self.units)

    def decode(self, frames: Bytes) -> tuple[npt.NDArray[np.int64], dict[str, Samples]]:
        """Counter of each frame, shape (n,), and the samples of each channel, shape (n · samples,), in physical units.

        `frames` has shape (n, length).
        """
        raw, values = self._values(frames)
        counter = raw[:, self._counter].astype(np.int64) if self.counter_bits else np.zeros(len(frames), np.int64)
        return counter, {name: values[:, members].reshape(-1) for name, members in self._channels.items()}

    def _values(self, frames: Bytes) -> tuple[npt.NDArray[np.uint64], Samples]:
        gathered = frames[:, self._index].astype(np.uint64) * self._weight << self._left
        raw = (np.bitwise_or.reduce(gathered, axis=2) >> self._right) & self._mask
        sign = np.uint64(1) << (self._bits - np.uint64(1))
        signed = np.where(self._signed, (raw ^ sign).astype(np.int64) - sign.astype(np.int64), raw.astype(np.int64))
        values = signed * self._scale + self._offset
        for k, bits in self._floats:
            values[:, k] = _as_float(raw[:, k], bits) * self._scale[k] + self._offset[k]
        return raw, values

    def encode(self, counter: npt.ArrayLike, channels: Mapping[str, npt.ArrayLike]) -> Bytes:
        """Frames, shape (n, length), from channels of shape (n · samples,); values are rounded and clipped to what fits."""
        counter = np.atleast_1d(np.asarray(counter, np.int64))
        values = np.zeros((len(counter), len(self._names)))
        for name, members in self._channels.items():
            values[:, members] = np.asarray(channels[name], float).reshape(len(counter), len(members))
        raw = self._raw((values - self._offset) / self._scale)
        if self.counter_bits:
            raw[:, self._counter] = counter.astype(np.uint64)
        raw = (raw & self._mask) << self._right
        frames = np.zeros((self.length, len(counter)), np.uint8)
        for j in range(self._index.shape[1]):
            byte = ((raw >> self._left[:, j]) & np.uint64(0xFF)) * self._weight[:, j]
            np.bitwise_or.at(frames, self._index[:, j], byte.T.astype(np.uint8))
        return np.ascontiguousarray(frames.T)

    def _raw(self, scaled: Samples) -> npt.NDArray[np.uint64]:
        bits = self._bits.astype(float)
        low = np.where(self._signed, -(2.0 ** (bits - 1)), 0.0)
        high = np.where(self._signed, 2.0 ** (bits - 1) - 1, 2.0**bits - 1)
        clipped = np.clip(np.rint(np.nan_to_num(scaled)), low, np.minimum(high, 2.0**62))
        raw = clipped.astype(np.int64).astype(np.uint64)
        for k, width in self._floats:
            kind, integer = (np.float32, np.uint32) if width == 32 else (np.float64, np.uint64)
            raw[:, k] = scaled[:, k].astype(kind).view(integer).astype(np.uint64)
        return raw


def _as_float(raw: npt.NDArray[np.uint64], bits: int) -> Samples:
    if bits == 32:
        return raw.astype(np.uint32).view(np.float32).astype(float)
    return np.ascontiguousarray(raw).view(np.float64)


def _span(start: int, length: int, byte_order: str) -> tuple[list[int], int]:
    """Bytes that a signal touches, most significant first, and how far its lowest bit is from the end of the last one."""
    if byte_order == "little_endian":
        first, last = start // 8, (start + length - 1) // 8
        return list(range(last, first - 1, -1)), start - 8 * first
    begin = 8 * (start // 8) + 7 - start % 8
    first, last = begin // 8, (begin + length - 1) // 8
    return list(range(first, last + 1)), 8 * (last + 1) - (begin + length)


def _counter_of(names: Sequence[str]) -> str | None:
    """The signal that counts frames."""
    if COUNTER in names:
        return COUNTER
    alike = [name for name in names if _COUNTER_LIKE.fullmatch(name)]
    return alike[0] if len(alike) == 1 else None


def _frame_time(message: Any) -> float:
    """Seconds from one frame to the next."""
    attributes = message.dbc.attributes if message.dbc else {}
    for name, unit in (("SampleTime", 1.0), ("GenMsgCycleTime", 1e-3)):
        if name in attributes and float(attributes[name].value) > 0:
            return float(attributes[name].value) * unit
    raise BadBusDescription(
        f"message {message.name}: has a counter and no time between frames; give it the attribute SampleTime [s] or "
        "GenMsgCycleTime [ms]"
    )


def read_dbc(path: str | Path) -> dict[str, FrameLayout]:
    """The messages of a DBC file by name; BadBusDescription when it is none."""
    where = Path(path).name
    try:
        database = load_file(str(path), database_format="dbc", strict=True)
    except (OSError, UnicodeDecodeError, DatabaseError) as error:
        raise BadBusDescription(f"{where}: cannot be read as a DBC file: {' '.join(str(error).split())}") from None
    if not isinstance(database, Database):
        raise BadBusDescription(f"{where}: is no CAN database")
    return {message.name: FrameLayout(message, where) for message in database.messages}
