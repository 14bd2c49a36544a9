"""RegisterMap: what a Modbus device keeps in its holding registers, from a YAML file.

A device of Residuum keeps each stream in a ring of *pages*, so that a reader that comes late loses nothing and can tell every
wrong reply from a right one:

    page = [page number, high word][low word][checksum][sample 0][sample 1] …

The page number p counts from 0 since the device started; page p lies at `address + stride · (p mod count)`. The checksum is
the low 16 bits of the CRC-32 (zlib) over the other registers of the page, big-endian. A sample is one or more registers,
described by `channels`. Two registers at `newest` hold the number of the newest complete page + 1 (0: none yet). Pages that lie
side by side (`stride` is the length of a page) are read several at once.

A stream of a device that has no such pages is polled: the plain registers at `address` are read every `sample_time` seconds,
on the reader's clock.

```yaml
streams:
  machine:
    sample_time: 0.001                # s
    pages: {newest: 0, address: 1000, stride: 124, count: 256, samples: 30}      # or  poll: {address: 0}
    channels:
      speed: {register: 1, type: uint16, scale: 0.001, unit: rpm}
      indicator: {register: 0, type: bit, bit: 0, unit: ""}
faults: {command: 100, state: 110, ids: [plier-bearing]}
```
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from residuum.service.fieldbus.block import Samples, StreamFormat
from residuum.service.fieldbus.frame_layout import BadBusDescription

Registers = npt.NDArray[np.uint16]
PAGE_HEAD = 3
"""Registers before the first sample of a page: number (2) and checksum."""
MOST_REGISTERS = 125
_TYPES: dict[str, tuple[str, int]] = {
    "uint16": (">u2", 1),
    "int16": (">i2", 1),
    "uint32": (">u4", 2),
    "int32": (">i4", 2),
    "float32": (">f4", 2),
    "float64": (">f8", 4),
}


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ChannelRegisters(_Strict):
    """Where a channel lies within a sample, and how it is to be read."""

    register_: int = Field(alias="register", ge=0, lt=MOST_REGISTERS)
    type: Literal["bit", "uint16", "int16", "uint32", "int32", "float32", "float64"] = "uint16"
    bit: int = Field(default=0, ge=0, le=15)
    scale: float = 1.0
    offset: float = 0.0
    unit: str = ""

    @property
    def width(self) -> int:
        """Registers of one value."""
        return 1 if self.type == "bit" else _TYPES[self.type][1]

    def decode(self, registers: Registers) -> Samples:
        """Values from registers of shape (n, words of a sample)."""
        words = registers[:, self.register_ : self.register_ + self.width]
        if self.type == "bit":
            return ((words[:, 0] >> self.bit) & 1).astype(float)
        values = np.ascontiguousarray(words.astype(">u2")).view(_TYPES[self.type][0])[:, 0].astype(float)
        return values * self.scale + self.offset

    def encode(self, values: npt.ArrayLike, registers: Registers) -> None:
        """Write values into registers of shape (n, words of a sample)."""
        values = np.asarray(values, float)
        if self.type == "bit":
            registers[:, self.register_] |= (values != 0).astype(np.uint16) << np.uint16(self.bit)
            return
        kind = np.dtype(_TYPES[self.type][0])
        scaled = (values - self.offset) / self.scale
        if kind.kind in "iu":
            scaled = np.clip(np.rint(np.nan_to_num(scaled)), np.iinfo(kind).min, np.iinfo(kind).max)
        words = scaled.astype(kind).reshape(-1, 1).view(">u2")
        registers[:, self.register_ : self.register_ + self.width] = words


class Pages(_Strict):
    """A ring of pages, see the module."""

    newest: int = Field(ge=0, le=65534)
    address: int = Field(ge=0, le=65535)
    stride: int = Field(ge=PAGE_HEAD + 1, le=MOST_REGISTERS + 3)
    count: int = Field(ge=4, le=4096)
    samples: int = Field(ge=1, le=MOST_REGISTERS)


class Poll(_Strict):
    """Plain registers, read at the reader's own pace."""

    address: int = Field(ge=0, le=65535)


class StreamRegisters(_Strict):
    """One stream: its clock, its channels, and where it lies."""

    sample_time: float = Field(gt=0)
    pages: Pages | None = None
    poll: Poll | None = None
    channels: dict[str, ChannelRegisters] = Field(min_length=1)

    @model_validator(mode="after")
    def _fits(self) -> StreamRegisters:
        if (self.pages is None) == (self.poll is None):
            raise ValueError("a stream needs either pages or poll")
        if self.page_registers > MOST_REGISTERS:
            raise ValueError(f"one read takes {self.page_registers} registers; Modbus allows {MOST_REGISTERS}")
        if self.pages and self.page_registers > self.pages.stride:
            raise ValueError(f"a page takes {self.page_registers} registers and the stride is {self.pages.stride}")
        if self.pages and self.pages.address + self.pages.stride * self.pages.count > 65536:
            raise ValueError("the pages go beyond register 65535")
        return self

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
        return StreamFormat(name, self.sample_time, {channel: where.unit for channel, where in self.channels.items()})

    def decode(self, registers: Registers) -> dict[str, Samples]:
        """Samples of each channel, shape (n,), from their registers, shape (n · words,): those behind the heads of pages."""
        table = registers.reshape(-1, self.words)
        return {name: channel.decode(table) for name, channel in self.channels.items()}

    def encode(self, channels: Mapping[str, npt.ArrayLike]) -> Registers:
        """Registers of the samples, shape (n · words,)."""
        n = len(np.asarray(next(iter(channels.values()))))
        table = np.zeros((n, self.words), np.uint16)
        for name, channel in self.channels.items():
            channel.encode(channels[name], table)
        return table.reshape(-1)


class FaultRegisters(_Strict):
    """Switching faults of a simulated device.

    `command` is a block of three registers: number of the fault (from 1) and its size as float32 (0 clears it, negative:
    default size).
    `state` holds the size of each fault in turn as float32, 0 when it is off.
    """

    command: int = Field(ge=0, le=65532)
    state: int = Field(ge=0, le=65400)
    ids: list[str] = Field(min_length=1, max_length=60)


class RegisterMap(_Strict):
    """The streams and faults of one device."""

    unit_id: int = Field(default=1, ge=0, le=247)
    streams: dict[str, StreamRegisters] = Field(min_length=1)
    faults: FaultRegisters | None = None


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
    try:
        content: Any = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise BadBusDescription(f"{where}: cannot be read as YAML: {' '.join(str(error).split())}") from None
    try:
        return RegisterMap.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(map(str, first["loc"])) or "top level"
        raise BadBusDescription(f"{where}, {place}: {first['msg'].removeprefix('Value error, ')}") from None
