"""ChannelRegisters: where a channel lies in a Modbus device's registers, how its words make a
number, and when it has none.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import BeforeValidator, Field, model_validator

from residuum.service.fieldbus.source import Samples
from residuum.service.fieldbus.strict_model import StrictModel

Registers = npt.NDArray[np.uint16]
Order = Literal["big", "little"]
Function = Literal["holding", "input", "coils", "discrete"]
MANUAL_NUMBERS: dict[str, tuple[tuple[int, int], ...]] = {
    "holding": ((400_001, 465_536), (40_001, 49_999)),
    "input": ((300_001, 365_536), (30_001, 39_999)),
}
"""Table → (first, last) of its numbers in manuals: with a digit for the table before, and from 1.
"""
OF_BITS = ("coils", "discrete")
"""Functions that give bits, not registers."""
NUMBERS: dict[str, tuple[str, int]] = {
    "uint16": (">u2", 1),
    "int16": (">i2", 1),
    "uint32": (">u4", 2),
    "int32": (">i4", 2),
    "uint64": (">u8", 4),
    "int64": (">i8", 4),
    "float32": (">f4", 2),
    "float64": (">f8", 4),
}
"""Type → its form in memory, and how many registers it takes."""
_ADDRESSES = 1 << 16
# What SunSpec devices put into a scale register that is not used.
_NO_POWER = 0x8000
# Beyond it no unit is scaled: such a register holds something else.
_LARGEST_POWER = 10


def _several(value: Any) -> Any:
    return value if isinstance(value, list | tuple) else (value,)


class ChannelRegisters(StrictModel):
    """Where a channel lies within a sample, and how it is to be read."""

    register_: int = Field(
        alias="register",
        ge=0,
        lt=_ADDRESSES,
        description="First register or coil, from the address.",
    )
    type: Literal[
        "bit", "uint16", "int16", "uint32", "int32", "uint64", "int64", "float32", "float64"
    ] = "uint16"
    registers: int | None = Field(
        default=None, ge=1, le=4, description="How many the manual gives it; must fit the type."
    )
    word_order: Order = Field(
        default="big", description="big: the high word comes first; little: the low word."
    )
    byte_order: Order = Field(
        default="big", description="Within a word; Modbus has it big, some devices little."
    )
    bit: int = Field(default=0, ge=0, le=15, description="type bit: the lowest bit, 0 to 15.")
    bits: int = Field(
        default=1, ge=1, le=16, description="type bit: how many bits make the number."
    )
    scale: float = 1.0
    offset: float = 0.0
    scale_register: int | None = Field(
        default=None,
        ge=0,
        lt=_ADDRESSES,
        description="Register with a signed power of ten that scales the value as well.",
    )
    missing: Annotated[tuple[int | float, ...], BeforeValidator(_several)] = Field(
        default=(),
        description=(
            "What the device puts there when it has no value, as in its registers: before scale and"
            " offset."
        ),
    )
    function: Function | None = Field(
        default=None, description="Which of the device's tables; None: the stream's."
    )
    unit: str = ""

    @model_validator(mode="after")
    def _consistent(self) -> ChannelRegisters:
        if self.registers is not None and self.registers != self.width:
            raise ValueError(
                f"type {self.type} takes {self.width} registers, registers says {self.registers};"
                " correct one"
            )
        if self.bit + self.bits > 16:
            raise ValueError(
                f"bits {self.bit} to {self.bit + self.bits - 1} do not lie in one register of 16"
            )
        if self.type != "bit" and "bits" in self.model_fields_set:
            raise ValueError(f"bits: only type bit has them, not {self.type}")
        if self.function is not None:
            self.refuse_other_than_bits(self.function)
        if self.register_ + self.width > _ADDRESSES:
            raise ValueError(
                f"type {self.type} at register {self.register_} goes beyond register 65535"
            )
        if self.scale == 0:
            raise ValueError("scale is 0: every value would be the same")
        return self

    def refuse_other_than_bits(self, function: Function) -> None:
        """ValueError where a table of bits is to give anything else."""
        if function in OF_BITS and (self.type != "bit" or self.bit or self.bits > 1):
            raise ValueError(
                f"function {function} gives single bits; type must be bit, without bit and bits"
            )

    @property
    def width(self) -> int:
        """Registers of one value."""
        return 1 if self.type == "bit" else NUMBERS[self.type][1]

    def decode(self, registers: Registers) -> Samples:
        """Values from registers of shape (n, words of a sample)."""
        return self.values(registers[:, self.register_ : self.register_ + self.width])

    def values(self, words: Registers) -> Samples:
        """Values from their own words, shape (n, width); NaN where the device says that it has
        none.
        """
        if self.type == "bit":
            raw = words[:, 0]
            values = ((raw >> self.bit) & ((1 << self.bits) - 1)).astype(float)
        else:
            raw = ordered(words, self.word_order, self.byte_order).view(NUMBERS[self.type][0])[:, 0]
            # words in another order than the map says may be a signalling NaN
            with np.errstate(invalid="ignore"):
                values = raw.astype(float)
        # by the raw number: a scale makes floats of it, which need not be equal
        for sentinel in self.missing:
            values[_equal(raw, sentinel)] = np.nan
        return values * self.scale + self.offset

    def encode(self, values: npt.ArrayLike, registers: Registers) -> None:
        """Write values into registers of shape (n, words of a sample); a missing one as the first
        of `missing`, else as 0.
        """
        values = np.asarray(values, float)
        scaled = (values - self.offset) / self.scale
        if self.missing:
            scaled = np.where(np.isnan(scaled), float(self.missing[0]), scaled)
        if self.type == "bit":
            field = np.clip(np.rint(np.nan_to_num(scaled)), 0, (1 << self.bits) - 1).astype(
                np.uint16
            )
            # a single bit says whether there is anything, however small: .3 is not off
            field = np.where(values != 0, np.uint16(1), np.uint16(0)) if self.bits == 1 else field
            # other channels have their bits in this register, too
            registers[:, self.register_] |= field << np.uint16(self.bit)
            return
        kind = np.dtype(NUMBERS[self.type][0])
        if kind.kind in "iu":
            # the largest double below 2⁶⁴ (2⁶³): the largest whole number itself would be rounded
            # up
            highest = min(
                float(np.iinfo(kind).max),
                np.nextafter(float(np.iinfo(kind).max), 0) if kind.itemsize == 8 else np.inf,
            )
            scaled = np.clip(np.rint(np.nan_to_num(scaled)), float(np.iinfo(kind).min), highest)
        words = scaled.astype(kind).reshape(-1, 1).view(">u2")
        registers[:, self.register_ : self.register_ + self.width] = ordered(
            words, self.word_order, self.byte_order
        )


def ordered(words: npt.NDArray[Any], word_order: Order, byte_order: Order) -> npt.NDArray[Any]:
    """Words, shape (n, width), with the high word and the high byte first; the same again turns
    them back.
    """
    turned = words[:, ::-1] if word_order == "little" else words
    big = np.ascontiguousarray(turned.astype(">u2"))
    return big.byteswap() if byte_order == "little" else big


def power_of_ten(register: int) -> float:
    """The factor that a scale register says; NaN where it says none.

    >>> power_of_ten(0xFFFF), power_of_ten(2), power_of_ten(0x8000)
    (0.1, 100.0, nan)
    """
    power = register - (register >= _NO_POWER) * _ADDRESSES
    return (
        float("nan")
        if register == _NO_POWER or abs(power) > _LARGEST_POWER
        else float(f"1e{power}")
    )


def _equal(raw: npt.NDArray[Any], sentinel: float) -> npt.NDArray[np.bool_]:
    """Where raw numbers are a sentinel; whole ones by their bits: 0x8000 and -32768 are the same
    register.
    """
    if raw.dtype.kind == "f":
        return np.asarray(raw == raw.dtype.type(sentinel))
    if sentinel != int(sentinel):
        return np.zeros(raw.shape, bool)
    unsigned = raw.astype(raw.dtype.newbyteorder("=")).view(f"u{raw.dtype.itemsize}")
    return np.asarray(unsigned == int(sentinel) % (1 << 8 * raw.dtype.itemsize))


# What a Modbus device means by an exception, and what to do about it.

_MEANINGS = {
    1: (
        "the device does not know this function; take another table (function: holding, input,"
        " coils or discrete)"
    ),
    2: "the device has no such register, or not all of these",
    3: "the device takes no such request; read fewer registers at once",
    4: "the device failed at it",
    6: "the device is busy; poll it less often",
    10: "the gateway has no way to this unit; look at unit_id",
    11: "no answer from behind the gateway; look at unit_id",
}
_TABLES = {
    "holding": "holding registers",
    "input": "input registers",
    "coils": "coils",
    "discrete": "discrete inputs",
}
_HOLES = "holes: name registers that are there, gap: 0"


def explained(code: int, function: str, address: int, count: int, address_base: int = 0) -> str:
    """An exception in one line: the registers by their address on the wire (from 0), what it means,
    what to do.

    `address_base` is what the map calls the first register, in which the advice is given.

    >>> explained(2, "holding", 40001, 2)[:71]
    'exception 2 for holding registers 40001 to 40002 (on the wire, from 0):'
    """
    span = f"{address}" if count == 1 else f"{address} to {address + count - 1}"
    says = (
        f"exception {code} for {_TABLES[function]} {span} (on the wire, from 0):"
        f" {_MEANINGS.get(code, 'see its manual')}"
    )
    if code != 2:
        return says
    written = address + address_base
    manual = next(
        (first for first, last in MANUAL_NUMBERS.get(function, ()) if first <= written <= last),
        None,
    )
    if manual is not None:
        meant = written - manual + address_base
        off = f"take {manual - address_base} off the address" + " (address_base: 1)" * address_base
        return f"{says}; a manual's {written} is address {meant} of this table: {off}"
    if address_base:
        return f"{says}; one off? where the manual counts from 0, leave address_base out; {_HOLES}"
    return f"{says}; one off? where the manual counts from 1, say address_base: 1; {_HOLES}"
