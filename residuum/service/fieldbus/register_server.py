"""RegisterServer: a Modbus TCP device that offers a register map: pages of streams, and fault registers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from residuum.service.fieldbus.register_map import (
    RegisterMap,
    Registers,
    StreamRegisters,
    build_page,
    float_registers,
    registers_float,
)

_WRITES = (6, 16)
_LAST = 65535

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


class RegisterServer:
    """A Modbus TCP server whose holding registers follow a register map.

    Parameters
    ----------
    registers : RegisterMap
    host, port : str, int
        Port 0 takes a free one.
    on_fault : callable
        Called when a client writes the fault command.
    """

    def __init__(self, registers: RegisterMap, host: str, port: int, on_fault: OnFault) -> None:
        self.memory: Registers = np.zeros(_LAST + 1, np.uint16)
        self._map, self._on_fault = registers, on_fault
        self._address = (host, port)
        self.pages = {name: StreamPages(self.memory, stream) for name, stream in registers.streams.items() if stream.pages}
        self.asked = 0

    async def start(self) -> int:
        """Listen; returns the port. OSError when it is taken."""
        device = SimDevice(
            id=self._map.unit_id,
            simdata=[SimData(0, values=0, count=_LAST, datatype=DataType.REGISTERS)],
            action=self._access,
        )
        self._server = ModbusTcpServer(device, address=self._address)
        try:
            await self._server.serve_forever(background=True)
        except RuntimeError as error:
            raise OSError(f"cannot listen on {self._address[0]}:{self._address[1]}: {error}") from None
        listening: Any = self._server.transport
        return int(listening.sockets[0].getsockname()[1])

    async def stop(self) -> None:
        """Stop listening."""
        await self._server.shutdown()  # type: ignore[no-untyped-call]

    def show_faults(self, sizes: Mapping[str, float]) -> None:
        """Write the sizes of the faults that are on into the state registers."""
        if faults := self._map.faults:
            for k, fault in enumerate(faults.ids):
                begin = faults.state + 2 * k
                self.memory[begin : begin + 2] = float_registers(sizes.get(fault, 0.0))

    async def _access(
        self, function: int, start: int, address: int, count: int, registers: list[int], values: list[int] | list[bool] | None
    ) -> ExcCodes | None:
        """Called by pymodbus before it reads or after it checked a write: the memory is ours."""
        begin = address - start
        if values is None or function not in _WRITES:
            self.asked += 1
            registers[begin : begin + count] = self.memory[address : address + count].tolist()
            return None
        return self._command(address, [int(value) for value in values])

    def _command(self, address: int, values: list[int]) -> ExcCodes | None:
        faults = self._map.faults
        if faults is None or address != faults.command or len(values) != 3:
            return ExcCodes.ILLEGAL_ADDRESS
        if not 1 <= values[0] <= len(faults.ids):
            return ExcCodes.ILLEGAL_VALUE
        self._on_fault(faults.ids[values[0] - 1], registers_float(values[1], values[2]))
        return None
