"""RegisterMap: what a Modbus device keeps in its registers, from a YAML file.

A device of Residuum keeps each stream in a ring of *pages*, so that a reader that comes late loses
nothing and can tell every wrong reply from a right one:

    page = [page number, high word][low word][checksum][sample 0][sample 1] …

The page number p counts from 0 since the device started; page p lies at `address + stride · (p mod
count)`. The checksum is the low 16 bits of the CRC-32 (zlib) over the other registers of the page,
big-endian. A sample is one or more registers, described by `channels`. Two registers at `newest`
hold the number of the newest complete page + 1 (0: none yet). Pages that lie side by side (`stride`
is the length of a page) are read several at once.

A stream of a device that has no such pages is polled: plain registers and coils are read every
`sample_time` seconds, on the reader's clock. `register` counts from the stream's `address`, and
`address` from 0 as on the wire, or from 1 where the map says `address_base: 1`, as many manuals do;
which of them is meant is never guessed. `channel_registers.py` says what a channel may have: types,
orders of words and bytes, bit fields, scales, and what stands there when there is no value.

```yaml
streams:
  machine:
    sample_time: 0.001                # s
    # or  poll: {address: 0}
    pages: {newest: 0, address: 1000, stride: 124, count: 256, samples: 30}
    channels:
      speed: {register: 1, type: uint16, scale: 0.001, unit: rpm}
      indicator: {register: 0, type: bit, bit: 0, unit: ""}
  meter:
    sample_time: 0.2
    # function: holding (default), input, coils, discrete
    poll: {address: 0, function: input, gap: 4}
    channels:
      power: {register: 0, type: float32, word_order: little, unit: W}
      temperature: {register: 4, type: int16, scale: 0.1, missing: -32768, unit: °C}
      state: {register: 12, type: bit, bit: 4, bits: 3}
      running: {register: 7, type: bit, function: coils}
faults: {command: 100, state: 110, ids: [plier-bearing]}
```
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field, ValidationError, model_validator

from residuum.nearest_names import known_names
from residuum.service.fieldbus.can.frame_layout import BadBusDescription
from residuum.service.fieldbus.map_text import read_map_text
from residuum.service.fieldbus.modbus.channel_registers import (
    OF_BITS,
    ChannelRegisters,
    Function,
    Registers,
    power_of_ten,
)
from residuum.service.fieldbus.modbus.modbus_client import CheckedModbusClient, DeviceRefused
from residuum.service.fieldbus.source import Samples, StreamFormat
from residuum.service.fieldbus.strict_model import StrictModel

PAGE_HEAD = 3
"""Registers before the first sample of a page: number (2) and checksum."""
MOST_REGISTERS = 125
"""That one read may ask for (Modbus application protocol 1.1b3, 6.3): a reply has up to 253 bytes.
"""


class Pages(StrictModel):
    """A ring of pages, see the module."""

    newest: int = Field(ge=0, le=65534)
    address: int = Field(ge=0, le=65535)
    stride: int = Field(ge=PAGE_HEAD + 1, le=MOST_REGISTERS + 3)
    count: int = Field(ge=4, le=4096)
    samples: int = Field(ge=1, le=MOST_REGISTERS)


class Poll(StrictModel):
    """Plain registers, read at the reader's own pace."""

    address: int = Field(
        ge=0, le=465_536, description="First register, as `address_base` counts them."
    )
    function: Function = Field(
        default="holding", description="Table of the channels that name none of their own."
    )
    gap: int = Field(
        default=0,
        ge=0,
        le=124,
        description="Holes of up to so many registers may be read with their neighbours.",
    )


class StreamRegisters(StrictModel):
    """One stream: its clock, its channels, and where it lies."""

    sample_time: float = Field(gt=0)
    pages: Pages | None = None
    poll: Poll | None = None
    channels: dict[str, ChannelRegisters] = Field(min_length=1)

    @model_validator(mode="after")
    def _fits(self) -> StreamRegisters:
        if (self.pages is None) == (self.poll is None):
            raise ValueError("a stream needs either pages or poll")
        _refuse_shared(self.channels, self.poll.function if self.poll else "holding")
        if self.poll:
            for channel in self.channels.values():
                channel.refuse_other_than_bits(channel.function or self.poll.function)
        if self.pages:
            self._refuse_unfit_pages(self.pages)
        return self

    def _refuse_unfit_pages(self, pages: Pages) -> None:
        """ValueError where the channels are none of pages, or the pages do not lie apart, each in
        one read.
        """
        for name, spec in self.channels.items():
            if spec.function not in (None, "holding") or spec.scale_register:
                raise ValueError(
                    f"channels.{name}: pages lie in holding registers, without scale registers;"
                    " poll it instead"
                )
        # a page that took two reads could be written over between them
        if self.page_registers > MOST_REGISTERS:
            raise ValueError(
                f"one read takes {self.page_registers} registers; Modbus allows {MOST_REGISTERS}"
            )
        if self.page_registers > pages.stride:
            raise ValueError(
                f"a page takes {self.page_registers} registers and the stride is {pages.stride}"
            )
        if pages.address + pages.stride * pages.count > 65536:
            raise ValueError("the pages go beyond register 65535")

    @property
    def words(self) -> int:
        """Registers of one sample."""
        return max(channel.register_ + channel.width for channel in self.channels.values())

    @property
    def samples(self) -> int:
        """Samples of one read."""
        return self.pages.samples if self.pages else 1

    @property
    def page_registers(self) -> int:
        """Registers of one read."""
        return self.words * self.samples + (PAGE_HEAD if self.pages else 0)

    def format(self, name: str) -> StreamFormat:
        """The stream as windows are cut from it."""
        return StreamFormat(
            name,
            self.sample_time,
            {channel: where.unit for channel, where in self.channels.items()},
        )

    def decode(self, registers: Registers) -> dict[str, Samples]:
        """Samples of each channel, shape (n,), from their registers, shape (n · words,): those
        behind the heads of pages.
        """
        table = registers.reshape(-1, self.words)
        return {name: channel.decode(table) for name, channel in self.channels.items()}

    def encode(self, channels: Mapping[str, npt.ArrayLike]) -> Registers:
        """Registers of the samples, shape (n · words,)."""
        n = len(np.asarray(next(iter(channels.values()))))
        table = np.zeros((n, self.words), np.uint16)
        for name, channel in self.channels.items():
            channel.encode(channels[name], table)
        return table.reshape(-1)


def _refuse_shared(channels: Mapping[str, ChannelRegisters], default: Function) -> None:
    """Refuse a register that two channels name, but for different bits of it."""
    owners: dict[tuple[Function, int], list[tuple[str, ChannelRegisters]]] = {}
    for name, channel in channels.items():
        for register in range(channel.register_, channel.register_ + channel.width):
            for owner, its in owners.setdefault((channel.function or default, register), []):
                if not _bits_apart(channel, its):
                    raise ValueError(
                        f"channels.{name}: register {register} belongs to {owner} already"
                        f" ({its.type} at {its.register_}, {its.width} registers); correct register"
                        " or type of one of them"
                    )
            owners[channel.function or default, register].append((name, channel))


def _bits_apart(first: ChannelRegisters, second: ChannelRegisters) -> bool:
    return first.type == second.type == "bit" and (
        first.bit + first.bits <= second.bit or second.bit + second.bits <= first.bit
    )


class FaultRegisters(StrictModel):
    """Switching faults of a simulated device.

    `command` is a block of three registers: number of the fault (from 1) and its size as float32 (0
    clears it, negative: default size). `state` holds the size of each fault in turn as float32, 0
    when it is off.
    """

    command: int = Field(ge=0, le=65532)
    state: int = Field(ge=0, le=65400)
    ids: list[str] = Field(min_length=1, max_length=60)


class RegisterMap(StrictModel):
    """The streams and faults of one device."""

    unit_id: int = Field(default=1, ge=0, le=247)
    address_base: Literal[0, 1] = Field(
        default=0, description="What the map calls the first register of a polled table."
    )
    streams: dict[str, StreamRegisters] = Field(min_length=1)
    faults: FaultRegisters | None = None

    @model_validator(mode="after")
    def _polled_from_the_base(self) -> RegisterMap:
        for name, stream in self.streams.items():
            if stream.poll and stream.poll.address < self.address_base:
                raise ValueError(
                    f"streams.{name}: address {stream.poll.address} lies before address_base"
                    f" {self.address_base}"
                )
            if (
                stream.poll
                and (last := stream.poll.address - self.address_base + stream.words - 1) > 0xFFFF
            ):
                raise ValueError(
                    f"streams.{name}: reaches register {last} on the wire; the last is 65535. Take"
                    " off the digit by which the manual tells the table: 400001 is address 0"
                    " (address_base: 0), function holding"
                )
        return self


@dataclass(frozen=True, eq=False)
class Page:
    """A page that was read and is whole."""

    number: int
    registers: Registers


def read_page(registers: Registers) -> Page | None:
    """The page in these registers, None when its checksum is wrong."""
    if checksum(registers) != registers[2]:
        return None
    return Page(int(registers[0]) << 16 | int(registers[1]), registers[PAGE_HEAD:])


def build_page(number: int, samples: npt.ArrayLike) -> Registers:
    """The registers of page `number` with these sample registers."""
    head = [number >> 16 & 0xFFFF, number & 0xFFFF, 0]
    page = np.concatenate([np.array(head, np.uint16), np.asarray(samples, np.uint16)])
    page[2] = checksum(page)
    return page


def checksum(page: Registers) -> int:
    """Low 16 bits of the CRC-32 over a page without its checksum register."""
    words = page.astype(">u2").tobytes()
    return zlib.crc32(words[2 * PAGE_HEAD :], zlib.crc32(words[:4])) & 0xFFFF


def float_registers(value: float) -> list[int]:
    """A float32 as two registers, high word first.

    >>> float_registers(1.0)
    [16256, 0]
    """
    return [int(word) for word in np.array([value], ">f4").view(">u2")]


def registers_float(high: int, low: int) -> float:
    """The float32 in two registers, high word first."""
    return float(np.array([high, low], ">u2").view(">f4")[0])


def read_register_map(path: str | Path) -> RegisterMap:
    """The register map in a YAML file; BadBusDescription names file, place and rule."""
    where = Path(path).name
    content = read_map_text(path)
    try:
        return RegisterMap.model_validate(content)
    except ValidationError as error:
        raise BadBusDescription(f"{where}, {first_error(error)}") from None


def first_error(error: ValidationError) -> str:
    """Place and rule of the first thing that is wrong, in one line."""
    first = error.errors(include_url=False)[0]
    place = ".".join(map(str, first["loc"])) or "top level"
    return f"{place}: {first['msg'].removeprefix('Value error, ')}{_known(first)}"


def _known(error: Any) -> str:
    """What could have been meant by a name that nothing has."""
    if error["type"] != "extra_forbidden":
        return ""
    for part, kind in (("channels", ChannelRegisters), ("poll", Poll)):
        if part in error["loc"]:
            names = [field.alias or name for name, field in kind.model_fields.items()]
            return f"; {known_names(error['loc'][-1], names)}"
    return ""


# Blocks of registers that one read takes, and the values of a polled stream from what was read.

# Coils that one read may ask for (Modbus application protocol 1.1b3, 6.1).
_MOST_BITS = 2000
Place = tuple[Function, int]
"""A register or coil: the table that it is in, and its address on the wire, which counts from 0."""


@dataclass(frozen=True)
class RegisterBlock:
    """Neighbouring registers or coils that are read at once."""

    function: Function
    first: int
    count: int


class PolledStream:
    """What is to be read of a polled stream, and what its channels make of it.

    Registers that no channel names are never read, but for holes of up to `gap` registers: many
    devices refuse a read that touches a register they do not have.

    Parameters
    ----------
    stream : StreamRegisters
    poll : Poll
    address_base : int
        What the map calls the first register, 0 or 1.
    """

    def __init__(self, stream: StreamRegisters, poll: Poll, address_base: int) -> None:
        self._channels = stream.channels
        self._poll, self._first = poll, poll.address - address_base

    def places(self, channel: ChannelRegisters) -> list[Place]:
        """The registers of a channel's value."""
        function = channel.function or self._poll.function
        return [(function, self._first + channel.register_ + k) for k in range(channel.width)]

    def _scale_place(self, channel: ChannelRegisters) -> list[Place]:
        if channel.scale_register is None:
            return []
        return [(channel.function or self._poll.function, self._first + channel.scale_register)]

    def blocks(self) -> list[RegisterBlock]:
        """The reads of one sample; a value is never parted between two of them."""
        values = {
            tuple(places)
            for spec in self._channels.values()
            for places in (self.places(spec), self._scale_place(spec))
            if places
        }
        # in order, so that only the last block can be the neighbour of the next value
        blocks: list[RegisterBlock] = []
        for places in sorted(values):
            (function, first), end = places[0], places[-1][1] + 1
            last = blocks[-1] if blocks and blocks[-1].function == function else None
            most = _MOST_BITS if function in OF_BITS else MOST_REGISTERS
            if (
                last
                and first <= last.first + last.count + self._poll.gap
                and end - last.first <= most
            ):
                blocks[-1] = RegisterBlock(function, last.first, max(last.count, end - last.first))
            else:
                blocks.append(RegisterBlock(function, first, end - first))
        return blocks

    def samples(self, read: Mapping[Place, int]) -> dict[str, Samples]:
        """One sample of each channel; NaN where a register of it was not read."""
        return {name: self._sample(channel, read) for name, channel in self._channels.items()}

    def _sample(self, channel: ChannelRegisters, read: Mapping[Place, int]) -> Samples:
        places, scale = self.places(channel), self._scale_place(channel)
        # a value without its power of ten would be a number that looks right
        if not all(place in read for place in (*places, *scale)):
            return np.full(1, np.nan)
        values = channel.values(np.array([[read[place] for place in places]], np.uint16))
        return values * power_of_ten(read[scale[0]]) if scale else values


async def read_blocks(
    client: CheckedModbusClient, blocks: Sequence[RegisterBlock]
) -> tuple[dict[Place, int], list[str]]:
    """The registers of all blocks that the device gives, and what it said of the others; BadReply
    when the connection fails.
    """
    read: dict[Place, int] = {}
    refusals = []
    for block in blocks:
        try:
            words = await client.read(block.first, block.count, block.function)
        except DeviceRefused as error:
            refusals.append(str(error))
        else:
            read.update(
                {(block.function, block.first + k): word for k, word in enumerate(words.tolist())}
            )
    return read, refusals
