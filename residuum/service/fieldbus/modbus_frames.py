"""Modbus TCP frames: how they are put on the wire, and cut out of what comes from it.

A frame is a head of seven bytes (transaction, protocol 0, bytes that follow, unit), the function, and its content.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import NamedTuple

READ_REGISTERS, WRITE_REGISTERS = 3, 16
REFUSED = 0x80
"""Added to the function of a reply that is an exception."""

_HEAD = struct.Struct(">HHHBB")
_COUNTED_FROM = 6
_LONGEST = 254
_PAIR = struct.Struct(">HH")


class NoModbus(Exception):
    """What came is no Modbus TCP; where the next frame begins cannot be known."""


class ModbusFrame(NamedTuple):
    """One request or reply."""

    transaction: int
    unit: int
    function: int
    content: bytes

    def packed(self) -> bytes:
        """As it goes over the wire."""
        return _HEAD.pack(self.transaction, 0, 2 + len(self.content), self.unit, self.function) + self.content


class FrameCutter:
    """Cuts a stream of bytes, which comes in pieces of any length, into frames."""

    def __init__(self) -> None:
        self._waiting = b""

    def cut(self, piece: bytes) -> Iterator[ModbusFrame]:
        """The frames that this piece completes; NoModbus, behind those in order, when what follows is none."""
        data, at = self._waiting + piece, 0
        while len(data) - at >= _HEAD.size:
            transaction, protocol, length, unit, function = _HEAD.unpack_from(data, at)
            if protocol != 0 or not 2 <= length <= _LONGEST:
                raise NoModbus(f"protocol {protocol}, length {length}")
            end = at + _COUNTED_FROM + length
            if end > len(data):
                break
            yield ModbusFrame(transaction, unit, function, data[at + _HEAD.size : end])
            at = end
        self._waiting = data[at:]


def two_numbers(first: int, second: int) -> bytes:
    """Address and count, as requests and confirmations have them."""
    return _PAIR.pack(first, second)


def read_two_numbers(content: bytes) -> tuple[int, int]:
    """Address and count; NoModbus when there are not as many bytes."""
    if len(content) < _PAIR.size:
        raise NoModbus(f"{len(content)} bytes of content, at least {_PAIR.size} are needed")
    first, second = _PAIR.unpack_from(content)
    return first, second
