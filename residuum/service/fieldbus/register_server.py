"""RegisterServer: a Modbus TCP device that offers a register map: pages of streams, and fault registers."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping

import numpy as np
import numpy.typing as npt

from residuum.service.fieldbus.modbus_frames import (
    READ_REGISTERS,
    REFUSED,
    WRITE_REGISTERS,
    FrameCutter,
    ModbusFrame,
    NoModbus,
    read_two_numbers,
)
from residuum.service.fieldbus.register_map import (
    MOST_REGISTERS,
    RegisterMap,
    Registers,
    StreamRegisters,
    build_page,
    float_registers,
    registers_float,
)

_ADDRESSES = 1 << 16
_ILLEGAL_FUNCTION, _ILLEGAL_ADDRESS, _ILLEGAL_VALUE, _NO_SUCH_UNIT = 1, 2, 3, 11
_WRITE_HEAD = 5
"""Bytes of a write before the registers: address, count, and the number of bytes that follow."""

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
        self.memory: Registers = np.zeros(_ADDRESSES, np.uint16)
        self._map, self._on_fault = registers, on_fault
        self._address = (host, port)
        self.pages = {name: StreamPages(self.memory, stream) for name, stream in registers.streams.items() if stream.pages}
        self.asked = 0
        self._clients: set[asyncio.Transport] = set()

    async def start(self) -> int:
        """Listen; returns the port. OSError when it is taken."""
        self._server = await asyncio.get_running_loop().create_server(
            lambda: _Conversation(self.answer, self._clients), *self._address
        )
        return int(self._server.sockets[0].getsockname()[1])

    async def stop(self) -> None:
        """Stop listening, and end the connections."""
        self._server.close()
        for client in list(self._clients):
            client.abort()
        await self._server.wait_closed()

    def show_faults(self, sizes: Mapping[str, float]) -> None:
        """Write the sizes of the faults that are on into the state registers."""
        if faults := self._map.faults:
            for k, fault in enumerate(faults.ids):
                begin = faults.state + 2 * k
                self.memory[begin : begin + 2] = float_registers(sizes.get(fault, 0.0))

    def answer(self, request: ModbusFrame) -> ModbusFrame:
        """The reply to a request; NoModbus for one that is too short to be any."""
        said = self._answered(request)
        if isinstance(said, int):
            return request._replace(function=request.function | REFUSED, content=bytes([said]))
        return request._replace(content=said)

    def _answered(self, request: ModbusFrame) -> bytes | int:
        """Content of the reply, or the number of the exception."""
        if self._map.unit_id not in (0, request.unit):
            return _NO_SUCH_UNIT
        if request.function == READ_REGISTERS:
            return self._read(*read_two_numbers(request.content))
        if request.function == WRITE_REGISTERS:
            return self._write(request.content)
        return _ILLEGAL_FUNCTION

    def _read(self, address: int, count: int) -> bytes | int:
        if not 1 <= count <= MOST_REGISTERS:
            return _ILLEGAL_VALUE
        if address + count > _ADDRESSES:
            return _ILLEGAL_ADDRESS
        self.asked += 1
        return bytes([2 * count]) + self.memory[address : address + count].astype(">u2").tobytes()

    def _write(self, content: bytes) -> bytes | int:
        address, count = read_two_numbers(content)
        words = content[_WRITE_HEAD:]
        if len(words) != 2 * count or content[_WRITE_HEAD - 1 : _WRITE_HEAD] != bytes([len(words)]):
            return _ILLEGAL_VALUE
        refused = self._command(address, np.frombuffer(words, ">u2").tolist())
        return content[: _WRITE_HEAD - 1] if refused is None else refused

    def _command(self, address: int, values: list[int]) -> int | None:
        faults = self._map.faults
        if faults is None or address != faults.command or len(values) != 3:
            return _ILLEGAL_ADDRESS
        if not 1 <= values[0] <= len(faults.ids):
            return _ILLEGAL_VALUE
        self._on_fault(faults.ids[values[0] - 1], registers_float(values[1], values[2]))
        return None


class _Conversation(asyncio.Protocol):
    """One client's connection: every request that has come is answered, all in one piece."""

    def __init__(self, answer: Callable[[ModbusFrame], ModbusFrame], clients: set[asyncio.Transport]) -> None:
        self._answer, self._clients = answer, clients
        self._cutter = FrameCutter()
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Called by asyncio."""
        if isinstance(transport, asyncio.Transport):
            self._transport = transport
            self._clients.add(transport)

    def data_received(self, data: bytes) -> None:
        """Called by asyncio."""
        if self._transport is None:
            return
        try:
            self._transport.write(b"".join([self._answer(request).packed() for request in self._cutter.cut(data)]))
        except NoModbus:
            self._transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Called by asyncio."""
        if self._transport is not None:
            self._clients.discard(self._transport)
