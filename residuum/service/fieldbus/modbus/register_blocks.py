"""Blocks of registers that one read takes, and the values of a polled stream from what was read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from residuum.service.fieldbus.block import Samples
from residuum.service.fieldbus.modbus.channel_registers import OF_BITS, ChannelRegisters, Function, power_of_ten
from residuum.service.fieldbus.modbus.modbus_client import CheckedModbusClient, DeviceRefused
from residuum.service.fieldbus.modbus.register_map import MOST_REGISTERS, Poll, StreamRegisters

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

    Registers that no channel names are never read, but for holes of up to `gap` registers: many devices refuse a read that
    touches a register they do not have.

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
            tuple(places) for each in self._channels.values() for places in (self.places(each), self._scale_place(each)) if places
        }
        blocks: list[RegisterBlock] = []
        for places in sorted(values):
            (function, first), end = places[0], places[-1][1] + 1
            last = blocks[-1] if blocks and blocks[-1].function == function else None
            most = _MOST_BITS if function in OF_BITS else MOST_REGISTERS
            if last and first <= last.first + last.count + self._poll.gap and end - last.first <= most:
                blocks[-1] = RegisterBlock(function, last.first, max(last.count, end - last.first))
            else:
                blocks.append(RegisterBlock(function, first, end - first))
        return blocks

    def samples(self, read: Mapping[Place, int]) -> dict[str, Samples]:
        """One sample of each channel; NaN where a register of it was not read."""
        return {name: self._sample(channel, read) for name, channel in self._channels.items()}

    def _sample(self, channel: ChannelRegisters, read: Mapping[Place, int]) -> Samples:
        places, scale = self.places(channel), self._scale_place(channel)
        if not all(place in read for place in (*places, *scale)):
            return np.full(1, np.nan)
        values = channel.values(np.array([[read[place] for place in places]], np.uint16))
        return values * power_of_ten(read[scale[0]]) if scale else values


async def read_blocks(client: CheckedModbusClient, blocks: Sequence[RegisterBlock]) -> tuple[dict[Place, int], list[str]]:
    """The registers of all blocks that the device gives, and what it said of the others; BadReply when the connection fails."""
    read: dict[Place, int] = {}
    refusals = []
    for block in blocks:
        try:
            words = await client.read(block.first, block.count, block.function)
        except DeviceRefused as error:
            refusals.append(str(error))
        else:
            read.update({(block.function, block.first + k): word for k, word in enumerate(words.tolist())})
    return read, refusals
