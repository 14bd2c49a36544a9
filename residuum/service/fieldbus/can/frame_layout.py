"""FrameLayout: the channels of a CAN message, from a DBC file; decodes and encodes many frames at
once with NumPy.

A frame that carries samples has the message attribute `SampleTime` [s] or `GenMsgCycleTime` [ms],
and best a sequence counter: the signal `counter`, else the only one that is called like an alive,
rolling, message or sequence counter. Every other signal is a channel with one sample a frame,
whatever its name; a multiplexed one is missing (NaN) in frames of other pages. Only where the
message attribute `SamplesPerFrame` says so (more than 1) are signals named `x_00`, `x_01`, …
successive samples of one channel `x`.

A message of SAE J1939 (`VFrameFormat` J1939PG) is its parameter group, see `frame_matching`. The
message attribute `SourceAddress` (0 to 253) names the device whose frames are meant.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from cantools.database.errors import Error as DatabaseError

from residuum.identification.errors import BadInput
from residuum.service.fieldbus.can.dbc_text import J1939, NoValueCodes, read_text
from residuum.service.fieldbus.can.frame_batch import EXTENDED
from residuum.service.fieldbus.source import Samples, StreamFormat

# SignalBits: where the signals of a CAN message lie in its frames; raw numbers and physical
# values of many frames at once.

Bytes = npt.NDArray[np.uint8]
Raw = npt.NDArray[np.uint64]
MOST_BITS = 64
# Bits of a floating-point signal → its type, and the whole number of the same bits.
_FLOATS: dict[int, tuple[Any, Any]] = {
    16: (np.float16, np.uint16),
    32: (np.float32, np.uint32),
    64: (np.float64, np.uint64),
}
_ALL_ONES = np.uint64(0xFFFFFFFFFFFFFFFF)


class SignalBits:
    """Bit positions, signs and scales of signals of at most 64 bits.

    Parameters
    ----------
    signals : sequence of cantools signals
    """

    def __init__(self, signals: Sequence[Any]) -> None:
        spans = [_span(signal.start, signal.length, signal.byte_order) for signal in signals]
        shape = (len(signals), max((len(order) for order, _ in spans), default=0))
        self._bits = np.array([signal.length for signal in signals], np.uint64)
        self._index, self._there = np.zeros(shape, np.intp), np.zeros(shape, bool)
        self._left, self._right = np.zeros(shape, np.uint64), np.zeros(shape, np.uint64)
        for k, (order, lowest) in enumerate(spans):
            for j, byte in enumerate(reversed(order)):
                self._index[k, j], self._there[k, j] = byte, True
                self._left[k, j], self._right[k, j] = max(8 * j - lowest, 0), max(lowest - 8 * j, 0)
        self._mask = _ALL_ONES >> (np.uint64(MOST_BITS) - self._bits)
        self._signed = np.array([signal.is_signed for signal in signals], bool)
        self._floats = [
            (k, signal.length) for k, signal in enumerate(signals) if signal.conversion.is_float
        ]
        self._scale = np.array([float(signal.conversion.scale) for signal in signals])
        self._offset = np.array([float(signal.conversion.offset) for signal in signals])

    def raw(self, frames: Bytes) -> Raw:
        """The bits of each signal as a number, shape (n, signals), from frames of shape (n,
        length).
        """
        # byte j of a signal, counted from its lowest, stands 8 j bits up, less the bits below the
        # signal that share its lowest byte; bytes that a signal does not have are taken as 0
        parts = (
            (frames[:, self._index].astype(np.uint64) * self._there) << self._left >> self._right
        )
        whole: Raw = np.bitwise_or.reduce(parts, axis=2) & self._mask
        return whole

    def values(self, raw: Raw) -> Samples:
        """Physical values of raw numbers, shape (n, signals)."""
        # two's complement of any width: x ^ s − s, with s the sign's bit
        sign = np.uint64(1) << (self._bits - np.uint64(1))
        signed = (raw ^ sign).astype(np.int64) - sign.astype(np.int64)
        values = (
            np.where(self._signed, signed.astype(float), raw.astype(float)) * self._scale
            + self._offset
        )
        for k, bits in self._floats:
            kind, integer = _FLOATS[bits]
            with np.errstate(invalid="ignore"):  # NaN is missing, also a signalling one
                values[:, k] = (
                    raw[:, k].astype(integer).view(kind).astype(float) * self._scale[k]
                    + self._offset[k]
                )
        return values

    def raw_of(self, values: Samples) -> Raw:
        """Raw numbers of physical values, shape (n, signals), rounded and clipped to what fits;
        missing ones as 0.
        """
        scaled = np.nan_to_num((values - self._offset) / self._scale)
        bits = self._bits.astype(float)
        # the largest float below 2⁶⁴ (2⁶³): the limit itself is no 64-bit number
        high = np.minimum(2.0**bits - 1, np.nextafter(2.0**64, 0))
        highest = np.minimum(2.0 ** (bits - 1) - 1, np.nextafter(2.0**63, 0))
        unsigned = np.clip(np.rint(np.where(self._signed, 0.0, scaled)), 0.0, high).astype(
            np.uint64
        )
        signed = np.clip(
            np.rint(np.where(self._signed, scaled, 0.0)), -(2.0 ** (bits - 1)), highest
        ).astype(np.int64)
        raw: Raw = np.where(self._signed, signed.astype(np.uint64), unsigned)
        for k, width in self._floats:
            kind, integer = _FLOATS[width]
            raw[:, k] = (
                ((values[:, k] - self._offset[k]) / self._scale[k])
                .astype(kind)
                .view(integer)
                .astype(np.uint64)
            )
        return raw

    def frames(self, raw: Raw, length: int) -> Bytes:
        """Frames, shape (n, length), that carry these raw numbers."""
        frames = np.zeros((length, len(raw)), np.uint8)
        masked = raw & self._mask
        for j in range(self._index.shape[1]):
            byte = (
                (masked >> self._left[:, j] << self._right[:, j]) & np.uint64(0xFF)
            ) * self._there[:, j]
            np.bitwise_or.at(frames, self._index[:, j], byte.T.astype(np.uint8))
        return np.ascontiguousarray(frames.T)


def usable_bits(signal: Any) -> bool:
    """Whether a signal is of a width that is read here: at most 64 bits, a floating-point one 16,
    32 or 64.
    """
    return signal.length in _FLOATS if signal.conversion.is_float else signal.length <= MOST_BITS


def _span(start: int, length: int, byte_order: str) -> tuple[list[int], int]:
    """Bytes that a signal touches, most significant first, and how far its lowest bit is from the
    end of the last one.
    """
    # a DBC file's start is the lowest bit of a little-endian signal, and the highest of a
    # big-endian one; in both, bit 0 of a byte is its lowest
    if byte_order == "little_endian":
        first, last = start // 8, (start + length - 1) // 8
        return list(range(last, first - 1, -1)), start - 8 * first
    begin = 8 * (start // 8) + 7 - start % 8
    first, last = begin // 8, (begin + length - 1) // 8
    return list(range(first, last + 1)), 8 * (last + 1) - (begin + length)


COUNTER = "counter"
NO_COUNTER = "no counter: losses cannot be seen"
SAMPLES_PER_FRAME = "SamplesPerFrame"
SOURCE_ADDRESS = "SourceAddress"
_NOBODY = 254
_FRAME_TIMES = (("SampleTime", 1.0), ("GenMsgCycleTime", 1e-3))
_COUNTER_LIKE = re.compile(
    r"(.*_)?(alive|rolling|message|msg|sequence|seq|frame)_?(counter|count|cnt)", re.IGNORECASE
)
# Widths that `SequenceCounter` unwraps.
_COUNTER_BITS = range(4, 33)
_INDEXED = re.compile(r"^(?P<channel>.+)_(?P<index>\d{2,})$")
# Of DBC files, whatever computer wrote them.
_ENCODING = "cp1252"
# Bytes that a frame of CAN FD may have beyond 8 (ISO 11898-1); others are filled up to the next.
_FD_LENGTHS = (12, 16, 20, 24, 32, 48, 64)


class BadBusDescription(BadInput):
    """A DBC file or register map cannot be used; the message names the file, the place and the
    rule.
    """


class FrameLayout:
    """Channels, counter, pages and units of one CAN message.

    Parameters
    ----------
    message : cantools message
    where : str
        File name for messages.

    Raises
    ------
    BadBusDescription
        A signal of more than 64 bits, signals that overlap or do not fit into the message, numbered
        signals that are not as many as the message says.
    """

    def __init__(self, message: Any, where: str) -> None:
        where = f"{where}, message {message.name}"
        self.name: str = message.name
        self.frame_id: int = message.frame_id
        self.is_extended: bool = message.is_extended_frame
        self.is_fd: bool = message.length > 8
        self.is_j1939: bool = _is_j1939(message)
        self.source_address = _source_address(message, where) if self.is_j1939 else None
        """Of J1939: the only device whose frames these are; None for any."""
        self.length: int = message.length
        signals = list(message.signals)
        _refuse_misplaced(message, signals, where)
        self._names = [signal.name for signal in signals]
        self._bits, self._multiplexing, self._codes = (
            SignalBits(signals),
            Multiplexing(signals),
            NoValueCodes(message),
        )
        self.choices: dict[str, dict[int, str]] = {
            signal.name: {int(key): str(value) for key, value in (signal.choices or {}).items()}
            for signal in signals
        }
        self._counter, self.remark = self._find_counter(signals)
        self.counter_bits: int = 0 if self._counter is None else signals[self._counter].length
        self._channels, self.samples = self._group(message, where)
        self.units = {
            name: signals[members[0]].unit or "" for name, members in self._channels.items()
        }
        self.sample_time = _frame_time(message) / self.samples

    def _find_counter(self, signals: Sequence[Any]) -> tuple[int | None, str]:
        """Place of the signal that counts frames, None without one; and what is to be said of
        it.
        """
        name = _counter_of(self._names)
        if name is None:
            return None, NO_COUNTER
        place = self._names.index(name)
        if place in self._multiplexing.paged:
            return None, f"{NO_COUNTER} ({name!r} is on a page, which not every frame carries)"
        if signals[place].length not in _COUNTER_BITS or signals[place].conversion.is_float:
            return (
                None,
                f"{NO_COUNTER} ({name!r} has {signals[place].length} bits; 4 to 32 are needed)",
            )
        return place, ""

    def _group(self, message: Any, where: str) -> tuple[dict[str, npt.NDArray[np.intp]], int]:
        """The places of each channel's samples, in their order, and how many a frame has."""
        samples = int(_attribute(message, SAMPLES_PER_FRAME) or 1)
        groups: dict[str, list[tuple[int, int]]] = {}
        for k, name in enumerate(self._names):
            if k == self._counter:
                continue
            indexed = _INDEXED.match(name) if samples > 1 else None
            channel, index = (indexed["channel"], int(indexed["index"])) if indexed else (name, 0)
            groups.setdefault(channel, []).append((index, k))
        for channel, members in groups.items():
            if len(members) != samples:
                raise BadBusDescription(
                    f"{where}: {SAMPLES_PER_FRAME} is {samples} and channel {channel!r} has"
                    f" {len(members)} signals; all must have {samples}, named {channel}_00,"
                    f" {channel}_01, …"
                )
        return {
            name: np.array([k for _, k in sorted(members)], np.intp)
            for name, members in groups.items()
        }, samples

    @property
    def bus_id(self) -> int:
        """The identifier with the bit that tells extended frames."""
        return self.frame_id | EXTENDED if self.is_extended else self.frame_id

    @property
    def in_packets(self) -> bool:
        """Whether no frame of classic CAN holds such a message: J1939 sends it in packets."""
        return self.is_j1939 and self.is_fd

    @property
    def own_source(self) -> int:
        """The source address in the identifier, of a message of J1939."""
        return source_of(self.frame_id)

    @property
    def why_no_stream(self) -> str:
        """Why frames of this message are no stream of samples; empty when they are one."""
        if not self._channels:
            return "carries no channel"
        if not self.sample_time:
            has = "has a counter and" if self.counter_bits else "has"
            return (
                f"{has} no time between frames; give it the attribute SampleTime [s] or"
                " GenMsgCycleTime [ms]"
            )
        return ""

    @property
    def format(self) -> StreamFormat:
        """The stream that these frames carry; BadBusDescription for frames that carry none."""
        if self.why_no_stream:
            raise BadBusDescription(f"message {self.name}: {self.why_no_stream}")
        return StreamFormat(self.name, self.sample_time, self.units)

    def fits(self, length: int) -> bool:
        """Whether a frame of so many bytes is one of these; CAN FD fills up to the next length that
        it knows.
        """
        return length == self.length or (
            self.is_fd
            and length
            == next((known for known in _FD_LENGTHS if known >= self.length), self.length)
        )

    def decode(self, frames: Bytes) -> tuple[npt.NDArray[np.int64], dict[str, Samples]]:
        """Counter of each frame, shape (n,), and the samples of each channel, shape (n · samples,),
        in physical units.

        `frames` has shape (n, length). What a frame does not carry, and a code for no value, is
        NaN; without a counter it is 0.
        """
        raw = self._bits.raw(frames)
        values = self._bits.values(raw)
        # pages first: which page a frame has is read from values, codes for no value among them
        if self._multiplexing.paged:
            values[~self._multiplexing.carried(values)] = np.nan
        values[self._codes.marked(raw)] = np.nan
        counter = (
            np.zeros(len(frames), np.int64)
            if self._counter is None
            else raw[:, self._counter].astype(np.int64)
        )
        return counter, {
            name: values[:, members].reshape(-1) for name, members in self._channels.items()
        }

    def codes(self, frames: Bytes) -> dict[str, int]:
        """How many samples of each channel are codes for no value, of those that have some."""
        if not self._codes:  # most messages: nothing to look for, frame by frame, on a fast bus
            return {}
        raw = self._bits.raw(frames)
        is_code = self._codes.marked(raw) & self._multiplexing.carried(self._bits.values(raw))
        many = {name: int(is_code[:, members].sum()) for name, members in self._channels.items()}
        return {name: count for name, count in many.items() if count}

    def encode(self, counter: npt.ArrayLike, channels: Mapping[str, npt.ArrayLike]) -> Bytes:
        """Frames, shape (n, length), from channels of shape (n · samples,); values are rounded and
        clipped to what fits.

        Of a multiplexed message a frame carries the page that its multiplexer's value names, and
        nothing of the others.
        """
        counter = np.atleast_1d(np.asarray(counter, np.int64))
        values = self._table(channels, len(counter))
        raw = np.where(self._multiplexing.carried(values), self._bits.raw_of(values), np.uint64(0))
        if self._counter is not None:
            raw[:, self._counter] = counter.astype(np.uint64)
        return self._bits.frames(raw, self.length)

    def complete(self, channels: Mapping[str, npt.ArrayLike], n: int) -> npt.NDArray[np.bool_]:
        """Of n frames those of which no value is missing that the frame would carry."""
        values = self._table(channels, n)
        lacking: npt.NDArray[np.bool_] = np.isnan(values) & self._multiplexing.carried(values)
        return np.asarray(~lacking.any(axis=1))

    def _table(self, channels: Mapping[str, npt.ArrayLike], n: int) -> Samples:
        values = np.zeros((n, len(self._names)))
        for name, members in self._channels.items():
            values[:, members] = np.asarray(channels[name], float).reshape(n, len(members))
        return values


def _refuse_misplaced(message: Any, signals: Sequence[Any], where: str) -> None:
    for signal in signals:
        if not usable_bits(signal):
            raise BadBusDescription(
                f"{where}: signal {signal.name!r} has {signal.length} bits; at most {MOST_BITS} are"
                " read"
            )
    try:
        message.refresh(strict=True)
    except DatabaseError as error:
        raise BadBusDescription(
            f"{where}: {' '.join(str(error).split())} Correct the file: signals of a page share no"
            " bits and lie in the message"
        ) from None


def _counter_of(names: Sequence[str]) -> str | None:
    """The signal that counts frames."""
    if COUNTER in names:
        return COUNTER
    alike = [name for name in names if _COUNTER_LIKE.fullmatch(name)]
    return alike[0] if len(alike) == 1 else None


def _attribute(message: Any, name: str) -> float | None:
    attributes = message.dbc.attributes if message.dbc else {}
    return float(attributes[name].value) if name in attributes else None


def _is_j1939(message: Any) -> bool:
    return bool(message.protocol == J1939 and message.is_extended_frame)


def _source_address(message: Any, where: str) -> int | None:
    address = _attribute(message, SOURCE_ADDRESS)
    # 254 is the address of nobody, which files have in identifiers and as this attribute's default
    if address is None or address == _NOBODY:
        return None
    if not (address.is_integer() and 0 <= address < _NOBODY):
        raise BadBusDescription(f"{where}: {SOURCE_ADDRESS} is {address:g}; must be 0 to 253")
    return int(address)


def _frame_time(message: Any) -> float:
    """Seconds from one frame to the next; 0 where the file does not say it."""
    # an attribute of 0 is the default of files that do not use it
    times = ((_attribute(message, name) or 0.0) * unit for name, unit in _FRAME_TIMES)
    return next((seconds for seconds in times if seconds > 0), 0.0)


class BusMessages(dict[str, FrameLayout]):
    """The messages of a DBC file by name; `unusable` has, by name, what is wrong with each of the
    others.

    Messages without signals are in neither: there is nothing to read in them.
    """

    def __init__(self, where: str = "DBC file") -> None:
        super().__init__()
        self.where = where
        self.unusable: dict[str, str] = {}
        self._names: dict[tuple[int, int | None], str] = {}

    def add(self, message: Any, *, by_source: bool = False) -> None:
        """Take in one message of cantools; `by_source` where source addresses alone tell its
        J1939 group from another message's.
        """
        try:
            layout = FrameLayout(message, self.where)
        except BadBusDescription as error:
            self.unusable[message.name] = str(error)
            return
        if by_source and layout.source_address is None and layout.own_source != _NOBODY:
            layout.source_address = layout.own_source
        key = (group_of(layout.bus_id) if layout.is_j1939 else layout.bus_id, layout.source_address)
        owner = self._names.get(key, message.name if message.name in self else None)
        if owner is None:
            self[message.name], self._names[key] = layout, message.name
        else:
            self.unusable[message.name] = (
                f"{self.where}, message {message.name}: has the name or identifier of {owner};"
                " keep one"
            )


def read_dbc(path: str | Path) -> BusMessages:
    """The messages of a DBC file by name; BadBusDescription when it is none.

    A message that cannot be used costs that message, a line that cannot be read that line:
    `unusable` says which and why.
    """
    where = Path(path).name
    messages = BusMessages(where)
    try:
        text = Path(path).read_bytes().decode(_ENCODING, errors="replace")
        database, left_out = read_text(text)
    except OSError as error:
        raise BadBusDescription(f"{path}: cannot be read: {error.strerror}") from None
    except DatabaseError as error:
        raise BadBusDescription(
            f"{where}: cannot be read as a DBC file: {' '.join(str(error).split())}; correct the"
            " file there"
        ) from None
    for place, why in left_out.items():
        messages.unusable[place] = (
            f"{where}, {place if ' ' in place else f'message {place}'}: {why}"
        )
    read = [m for m in database.messages if m.signals and m.name not in left_out]
    groups = Counter(group_of(m.frame_id) for m in read if _is_j1939(m))
    for message in read:
        shared = _is_j1939(message) and groups[group_of(message.frame_id)] > 1
        messages.add(message, by_source=shared)
    return messages


# Multiplexing: which signals of a CAN message a frame carries, by the page that its multiplexer
# signals name.


class Multiplexing:
    """Pages of a message, cascaded ones too (a multiplexer that is itself on a page).

    Parameters
    ----------
    signals : sequence of cantools signals
    """

    def __init__(self, signals: Sequence[Any]) -> None:
        place = {signal.name: k for k, signal in enumerate(signals)}
        paged = [
            signal
            for signal in signals
            if signal.multiplexer_ids is not None and signal.multiplexer_signal in place
        ]
        parent = {place[signal.name]: place[signal.multiplexer_signal] for signal in paged}
        self._pages = sorted(
            (
                (
                    place[signal.name],
                    parent[place[signal.name]],
                    np.array(signal.multiplexer_ids, float),
                )
                for signal in paged
            ),
            # a multiplexer before what it pages: whether it is carried itself has to be known
            key=lambda page: _depth(page[0], parent),
        )
        self.paged = frozenset(parent)
        """Places of the signals that not every frame carries."""

    def carried(self, values: Samples) -> npt.NDArray[np.bool_]:
        """Which of the values, shape (n, signals), their frames carry."""
        carried = np.ones(values.shape, bool)
        for k, multiplexer, pages in self._pages:
            carried[:, k] = carried[:, multiplexer] & np.isin(
                np.trunc(values[:, multiplexer]), pages
            )
        return carried


def _depth(signal: int, parent: dict[int, int]) -> int:
    """How many multiplexers stand above a signal; one that is above itself is as deep as there are
    signals.
    """
    depth = 0
    while signal in parent and depth <= len(parent):
        signal, depth = parent[signal], depth + 1
    return depth


# J1939 identifiers have 29 bits (SAE J1939-21): priority 3, extended data page 1, data page 1, PDU
# format (PF) 8, PDU specific (PS) 8, source address 8. PS belongs to the parameter group where PF
# is at least 240; below that it is the destination.

_FIRST_BROADCAST = 240


def group_of(identifier: int) -> int:
    """The parameter group number of an extended frame.

    >>> hex(group_of(0x0CF00417)), hex(group_of(0x18EA2103))
    ('0xf004', '0xea00')
    """
    group = identifier >> 8 & 0x3FFFF
    return group if group >> 8 & 0xFF >= _FIRST_BROADCAST else group & 0x3FF00


def source_of(identifier: int) -> int:
    """The source address of an extended frame."""
    return identifier & 0xFF
