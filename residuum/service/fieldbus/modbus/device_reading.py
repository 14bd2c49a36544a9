"""A Modbus device read once: the words on the wire beside what the map, and each other order of
words, makes of them.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from residuum.library.answers.plain import finite
from residuum.service.fieldbus.modbus.channel_registers import (
    NUMBERS,
    ChannelRegisters,
    Order,
    Registers,
    ordered,
)
from residuum.service.fieldbus.modbus.modbus_client import (
    BadReply,
    CheckedModbusClient,
    DeviceRefused,
)
from residuum.service.fieldbus.modbus.register_map import (
    Pages,
    Place,
    PolledStream,
    RegisterMap,
    StreamRegisters,
    build_page,
    float_registers,
    read_blocks,
    read_page,
    registers_float,
)

# DeviceRegisters: what a device with a register map holds in its registers: pages of streams, and
# faults.

_ADDRESSES = 1 << 16
_COMMAND_WORDS = 3

OnFault = Callable[[str, float], None]
"""Told of a fault to switch: its id and size (0 clears it, negative: default size)."""


class StreamPages:
    """The pages of one stream in the device's memory, filled as samples come."""

    def __init__(self, memory: Registers, stream: StreamRegisters) -> None:
        if stream.pages is None:
            raise ValueError("StreamPages: the stream is polled, it has no pages")
        self._memory, self._stream, self._pages = memory, stream, stream.pages
        self._waiting = np.empty(0, np.uint16)
        self.complete = 0

    def append(self, channels: Mapping[str, npt.ArrayLike]) -> None:
        """Take samples and publish every page that they complete."""
        self.append_registers(self._stream.encode(channels))

    def append_registers(self, samples: Registers) -> None:
        """Take samples as registers and publish every page that they complete."""
        self._waiting = np.concatenate([self._waiting, samples])
        size = self._stream.words * self._stream.samples
        while len(self._waiting) >= size:
            self.publish(build_page(self.complete, self._waiting[:size]))
            self._waiting = self._waiting[size:]

    def publish(self, page: Registers) -> None:
        """Put a whole page into the ring and count it."""
        begin = self._pages.address + self._pages.stride * (self.complete % self._pages.count)
        self._memory[begin : begin + len(page)] = page
        self.complete += 1
        self._memory[self._pages.newest : self._pages.newest + 2] = (
            self.complete >> 16,
            self.complete & 0xFFFF,
        )


class DeviceRegisters:
    """The holding registers of one device.

    Parameters
    ----------
    registers : RegisterMap
    on_fault : callable
        Called when the fault command is written.
    """

    def __init__(self, registers: RegisterMap, on_fault: OnFault) -> None:
        self.memory: Registers = np.zeros(_ADDRESSES, np.uint16)
        self.unit_id = registers.unit_id
        self.pages = {
            name: StreamPages(self.memory, stream)
            for name, stream in registers.streams.items()
            if stream.pages
        }
        self._faults, self._on_fault = registers.faults, on_fault

    def show_faults(self, sizes: Mapping[str, float]) -> None:
        """Write the sizes of the faults that are on into the state registers."""
        if faults := self._faults:
            for k, fault in enumerate(faults.ids):
                begin = faults.state + 2 * k
                self.memory[begin : begin + 2] = float_registers(sizes.get(fault, 0.0))

    def takes_command(self, address: int, count: int) -> bool:
        """Whether these registers are those of the fault command."""
        return self._faults is not None and (address, count) == (
            self._faults.command,
            _COMMAND_WORDS,
        )

    def command(self, values: Sequence[int]) -> bool:
        """Switch a fault; whether there is one of this number."""
        if self._faults is None or not 1 <= values[0] <= len(self._faults.ids):
            return False
        self._on_fault(self._faults.ids[values[0] - 1], registers_float(values[1], values[2]))
        return True


_ORDERS: tuple[tuple[Order, Order], ...] = (
    ("big", "big"),
    ("little", "big"),
    ("big", "little"),
    ("little", "little"),
)
MISSING = "missing"
"""Remark on a reading that means, as the map says, that there is no value."""
# Power of ten that measured values are mostly nearest to.
_USUAL = 2.0
# Powers of ten from the usual one; what is further off is no measured value in any order.
_FURTHEST = 9.0
# Powers of ten by which an order that turns the bytes of words has to look better: it is met far
# less often.
_RARE = 3.0
# Numbers from the top of an unsigned register down that are taken for negative ones.
_SLIGHTLY_BELOW_ZERO = 2048
# Type → what devices often put into registers that have no value.
_NOT_THERE = {
    "int16": (0x8000, 0x7FFF),
    "uint16": (0xFFFF, 0x8000),
    "int32": (0x80000000, 0x7FFFFFFF),
    "uint32": (0xFFFFFFFF, 0x80000000),
    "int64": (0x8000000000000000,),
    "uint64": (0xFFFFFFFFFFFFFFFF, 0x8000000000000000),
}


@dataclass(frozen=True)
class ChannelReading:
    """One channel as it was read.

    `words` are as on the wire; `value` is what the map makes of them (None: missing); `orders` has
    what each order of words and bytes makes of them, where there are several, and `plausible` the
    one that looks most like a measured value.
    """

    stream: str
    channel: str
    unit: str
    function: str
    address: int
    words: tuple[int, ...]
    value: float | None
    orders: dict[str, float | None] = field(default_factory=dict)
    plausible: str | None = None
    remark: str = ""


def read_device(
    host: str, port: int, registers: RegisterMap, timeout: float = 3.0
) -> tuple[list[ChannelReading], list[str]]:
    """What a device gives of each channel, and what it refused, each in a line.

    Raises OSError when nobody answers there, TimeoutError when no fitting reply comes.
    """
    return asyncio.run(_read(host, port, registers, timeout))


async def _read(
    host: str, port: int, registers: RegisterMap, timeout: float
) -> tuple[list[ChannelReading], list[str]]:
    client = CheckedModbusClient(host, port, registers.unit_id, timeout, registers.address_base)
    readings: list[ChannelReading] = []
    refusals: list[str] = []
    try:
        await client.connect()
    except BadReply as error:
        client.close()
        raise OSError(f"{host}:{port}: {error}") from None
    try:
        for name, stream in registers.streams.items():
            try:
                readings += await _stream(client, name, stream, registers.address_base, refusals)
            except DeviceRefused as error:
                refusals.append(f"{name}: {error}")
    except BadReply as error:
        raise TimeoutError(f"{host}:{port}: {error}") from None
    finally:
        client.close()
    return readings, refusals


async def _stream(
    client: CheckedModbusClient, name: str, stream: StreamRegisters, base: int, refusals: list[str]
) -> list[ChannelReading]:
    if stream.pages:
        return await _newest_sample(client, name, stream, stream.pages, refusals)
    if stream.poll is None:
        return []
    polled = PolledStream(stream, stream.poll, base)
    read, refused = await read_blocks(client, polled.blocks())
    refusals += [f"{name}: {refusal}" for refusal in refused]
    return readings_of(name, stream, polled, read, polled.samples(read))


def readings_of(
    name: str,
    stream: StreamRegisters,
    polled: PolledStream,
    read: Mapping[Place, int],
    values: Mapping[str, npt.NDArray[np.float64]],
) -> list[ChannelReading]:
    """Each channel of which every register was read."""
    return [
        reading_of(
            name,
            channel,
            where,
            places[0],
            tuple(read[place] for place in places),
            float(values[channel][0]),
        )
        for channel, where in stream.channels.items()
        for places in [polled.places(where)]
        if all(place in read for place in places)
    ]


async def _newest_sample(
    client: CheckedModbusClient,
    name: str,
    stream: StreamRegisters,
    pages: Pages,
    refusals: list[str],
) -> list[ChannelReading]:
    high, low = (await client.read(pages.newest, 2)).tolist()
    number = high << 16 | low
    if not number:
        refusals.append(f"{name}: the device has published no page yet")
        return []
    begin = pages.address + pages.stride * ((number - 1) % pages.count)
    page = read_page(await client.read(begin, stream.page_registers))
    if page is None:
        refusals.append(
            f"{name}: the newest page, at {begin}, has a wrong checksum: look at address, stride"
            " and count"
        )
        return []
    sample = page.registers[-stream.words :]
    place = begin + stream.page_registers - stream.words
    return [
        reading_of(
            name,
            channel,
            where,
            ("holding", place + where.register_),
            _words(sample, where),
            _value(sample, where),
        )
        for channel, where in stream.channels.items()
    ]


def _words(sample: Registers, where: ChannelRegisters) -> tuple[int, ...]:
    return tuple(sample[where.register_ : where.register_ + where.width].tolist())


def _value(sample: Registers, where: ChannelRegisters) -> float:
    return float(where.decode(sample[None, :])[0])


def reading_of(
    stream: str,
    channel: str,
    where: ChannelRegisters,
    place: tuple[str, int],
    words: tuple[int, ...],
    value: float,
) -> ChannelReading:
    """One channel's words and value, judged: what other orders make of them, and what looks wrong."""
    orders = _orders(where, words)
    mapped = order_name(where.word_order, where.byte_order, where.width)
    plausible = _plausible(orders, mapped) if orders and not math.isnan(value) else None
    function, address = place
    remark = _remark(where, words, value)
    if plausible not in (None, mapped) and not remark:
        remark = f"{plausible} looks more like a measured value than {mapped}, which the map says"
    return ChannelReading(
        stream, channel, where.unit, function, address, words, finite(value),
        {name: finite(number) for name, number in orders.items()}, plausible, remark,
    )  # fmt: skip


def order_name(word_order: Order, byte_order: Order, width: int) -> str:
    """An order as manuals write it, the highest byte of the value as A.

    >>> [order_name(*order, 2) for order in _ORDERS]
    ['ABCD', 'CDAB', 'BADC', 'DCBA']
    """
    letters = "ABCDEFGH"[: 2 * width]
    words = [letters[k : k + 2] for k in range(0, 2 * width, 2)]
    turned = words[::-1] if word_order == "little" else words
    return "".join(word[::-1] if byte_order == "little" else word for word in turned)


def _orders(where: ChannelRegisters, words: tuple[int, ...]) -> dict[str, float]:
    """What each order makes of the words, scaled as the map says."""
    if where.type == "bit" or where.width < 2:
        return {}
    table, values = np.array([words], np.uint16), {}
    for order in _ORDERS:
        raw = ordered(table, *order).view(NUMBERS[where.type][0])[:, 0]
        with np.errstate(invalid="ignore"):
            values[order_name(*order, where.width)] = (
                float(raw.astype(float)[0]) * where.scale + where.offset
            )
    return values


def _plausible(orders: dict[str, float], mapped: str) -> str | None:
    """The order whose value is nearest to what is mostly measured; the map's where others are no
    better; None when none is.
    """

    def distance(name: str) -> float:
        value = abs(orders[name])
        if not math.isfinite(value):
            far = math.inf
        elif value == 0:
            far = _USUAL  # as far as a value of 1
        else:
            far = abs(math.log10(value) - _USUAL)
        # `AB` stands in the name where bytes are not turned
        return far if name == mapped or "AB" in name else far + _RARE

    # the map's order wins a tie: only what is better is worth a remark
    best = min(orders, key=lambda name: (distance(name), name != mapped))
    best = mapped if distance(mapped) <= distance(best) else best
    return best if distance(best) <= _FURTHEST else None


def _remark(where: ChannelRegisters, words: tuple[int, ...], value: float) -> str:
    raw = 0
    for word in ordered(np.array([words], np.uint16), where.word_order, where.byte_order)[
        0
    ].tolist():
        raw = raw << 16 | word
    if math.isnan(value):
        return MISSING
    bits = 16 * where.width
    if raw in _NOT_THERE.get(where.type, ()):
        is_negative = where.type.startswith("int") and raw >> (bits - 1)
        signed = raw - (1 << bits) if is_negative else raw
        return f"0x{raw:X} mostly means that there is no value: say missing: {signed}"
    if where.type in ("uint16", "uint32") and raw >= (1 << bits) - _SLIGHTLY_BELOW_ZERO:
        negative = (raw - (1 << bits)) * where.scale + where.offset
        return (
            f"0x{raw:X} looks more like {negative:.6g} than {value:.6g}: say type: {where.type[1:]}"
        )
    return ""


def as_plain(reading: ChannelReading) -> dict[str, Any]:
    """A reading as plain values, the words in hexadecimal."""
    return {**vars(reading), "words": [f"{word:04X}" for word in reading.words]}
