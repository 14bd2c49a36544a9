"""DeviceRegisters: what a device with a register map holds in its registers: pages of streams, and faults."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from residuum.service.fieldbus.modbus.channel_registers import Registers
from residuum.service.fieldbus.modbus.register_map import (
    RegisterMap,
    StreamRegisters,
    build_page,
    float_registers,
    registers_float,
)

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
        self._memory[self._pages.newest : self._pages.newest + 2] = (self.complete >> 16, self.complete & 0xFFFF)


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
        self.pages = {name: StreamPages(self.memory, stream) for name, stream in registers.streams.items() if stream.pages}
        self._faults, self._on_fault = registers.faults, on_fault

    def show_faults(self, sizes: Mapping[str, float]) -> None:
        """Write the sizes of the faults that are on into the state registers."""
        if faults := self._faults:
            for k, fault in enumerate(faults.ids):
                begin = faults.state + 2 * k
                self.memory[begin : begin + 2] = float_registers(sizes.get(fault, 0.0))

    def takes_command(self, address: int, count: int) -> bool:
        """Whether these registers are those of the fault command."""
        return self._faults is not None and (address, count) == (self._faults.command, _COMMAND_WORDS)

    def command(self, values: Sequence[int]) -> bool:
        """Switch a fault; whether there is one of this number."""
        if self._faults is None or not 1 <= values[0] <= len(self._faults.ids):
            return False
        self._on_fault(self._faults.ids[values[0] - 1], registers_float(values[1], values[2]))
        return True
