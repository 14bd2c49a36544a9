"""StrictModbusClient: Modbus TCP reads and writes that believe no reply which does not fit its request.

Every reply is held against its request: transaction, unit, function, number of registers. Transaction numbers begin anywhere, so
that a gateway's late reply to an earlier connection is not taken for the one awaited; and after a reply that does not fit the
connection is to be given up with all that may still be under way in it.
"""

from __future__ import annotations

import asyncio
import random
import struct
from collections.abc import Sequence

import numpy as np

from residuum.service.fieldbus.health import SourceHealth
from residuum.service.fieldbus.modbus_frames import (
    READ_REGISTERS,
    REFUSED,
    WRITE_REGISTERS,
    FrameCutter,
    ModbusFrame,
    NoModbus,
    two_numbers,
)
from residuum.service.fieldbus.register_map import Registers

_LAST_FIRST_TRANSACTION = 30_000
_LAST_TRANSACTION = 0xFFFF


class BadReply(Exception):
    """A reply that must not be believed; `counter` names the loss counter it belongs to."""

    def __init__(self, counter: str, message: str) -> None:
        super().__init__(message)
        self.counter = counter


class DeviceRefused(Exception):
    """The device answered with a Modbus exception; the connection is in order."""


class StrictModbusClient:
    """One connection to one device.

    Parameters
    ----------
    host, port, unit_id
        The device; unit 0 takes replies of any.
    timeout : float
        For connecting and for each reply [s].
    health : SourceHealth
        Replies that nobody awaits, and bytes that are no Modbus, are counted here.
    """

    def __init__(self, host: str, port: int, unit_id: int, timeout: float, health: SourceHealth) -> None:
        self._address, self._unit_id, self._timeout = (host, port), unit_id, timeout
        self._replies = _Replies(health)
        self._transaction = random.randint(1, _LAST_FIRST_TRANSACTION)
        self._transport: asyncio.Transport | None = None
        self._turn = asyncio.Lock()

    async def connect(self) -> bool:
        """Connect once; False when nobody answers."""
        try:
            async with asyncio.timeout(self._timeout):
                self._transport, _ = await asyncio.get_running_loop().create_connection(lambda: self._replies, *self._address)
        except OSError:
            return False
        return True

    def close(self) -> None:
        """Give the connection up."""
        if self._transport is not None:
            self._transport.abort()

    async def read(self, address: int, count: int) -> Registers:
        """`count` holding registers; BadReply, DeviceRefused, TimeoutError."""
        return (await self.read_all([(address, count)]))[0]

    async def read_all(self, places: Sequence[tuple[int, int]]) -> list[Registers]:
        """The holding registers at each (address, count), asked for all at once; BadReply, DeviceRefused, TimeoutError."""
        replies = await self._ask(READ_REGISTERS, [two_numbers(*place) for place in places])
        return [_registers(reply, *place) for reply, place in zip(replies, places, strict=True)]

    async def write(self, address: int, registers: list[int]) -> None:
        """Write holding registers; BadReply, DeviceRefused, TimeoutError."""
        where, words = two_numbers(address, len(registers)), struct.pack(f">{len(registers)}H", *registers)
        (reply,) = await self._ask(WRITE_REGISTERS, [where + bytes([len(words)]) + words])
        if reply != where:
            raise BadReply("corrupt_replies", f"registers {address}…: the reply does not confirm what was written")

    async def _ask(self, function: int, contents: Sequence[bytes]) -> list[bytes]:
        """The content of the reply to each request, once all replies have come."""
        async with self._turn:
            if self._transport is None or self._transport.is_closing():
                raise BadReply("bus_errors", "the connection broke")
            frames = [ModbusFrame(self._next_transaction(), self._unit_id, function, content) for content in contents]
            awaited = self._replies.to([frame.transaction for frame in frames])
            try:
                self._transport.write(b"".join(frame.packed() for frame in frames))
                replies = [await self._reply(each) for each in awaited]
            finally:
                self._replies.forget([frame.transaction for frame in frames])
        return [self._content(reply, function) for reply in replies]

    def _next_transaction(self) -> int:
        self._transaction = self._transaction % _LAST_TRANSACTION + 1
        return self._transaction

    async def _reply(self, awaited: asyncio.Future[ModbusFrame | None]) -> ModbusFrame:
        async with asyncio.timeout(self._timeout):
            reply = await awaited
        if reply is None:
            raise BadReply("bus_errors", "the connection broke")
        return reply

    def _content(self, reply: ModbusFrame, function: int) -> bytes:
        if self._unit_id and reply.unit != self._unit_id:
            raise BadReply("late_replies", f"reply of unit {reply.unit}, that of {self._unit_id} was awaited")
        if reply.function == function | REFUSED:
            raise DeviceRefused(f"exception {reply.content[0] if reply.content else 'without a number'}")
        if reply.function != function:
            raise BadReply("corrupt_replies", f"reply of function {reply.function}, that of {function} was awaited")
        return reply.content


class _Replies(asyncio.Protocol):
    """What comes over one connection, given to whoever awaits it."""

    def __init__(self, health: SourceHealth) -> None:
        self._health = health
        self._cutter = FrameCutter()
        self._awaited: dict[int, asyncio.Future[ModbusFrame | None]] = {}
        self._transport: asyncio.BaseTransport | None = None

    def to(self, transactions: Sequence[int]) -> list[asyncio.Future[ModbusFrame | None]]:
        """The replies to these requests; None when the connection broke before."""
        loop = asyncio.get_running_loop()
        for transaction in transactions:
            self._awaited[transaction] = loop.create_future()
        return [self._awaited[transaction] for transaction in transactions]

    def forget(self, transactions: Sequence[int]) -> None:
        """Nobody awaits these any more: a reply that still comes is late."""
        for transaction in transactions:
            self._awaited.pop(transaction, None)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Called by asyncio."""
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        """Called by asyncio."""
        try:
            for frame in self._cutter.cut(data):
                self._take(frame)
        except NoModbus as error:
            self._health.count("undecodable", 1, f"no Modbus: {error}")
            if isinstance(self._transport, asyncio.Transport):
                self._transport.abort()

    def _take(self, frame: ModbusFrame) -> None:
        awaited = self._awaited.pop(frame.transaction, None)
        if awaited is None:
            self._health.count("late_replies", 1, f"a reply to request {frame.transaction} that nobody awaited")
        elif not awaited.done():
            awaited.set_result(frame)

    def connection_lost(self, exc: Exception | None) -> None:
        """Called by asyncio."""
        for awaited in self._awaited.values():
            if not awaited.done():
                awaited.set_result(None)
        self._awaited.clear()


def _registers(content: bytes, address: int, count: int) -> Registers:
    if not content or content[0] != len(content) - 1 or content[0] % 2:
        raise BadReply("undecodable", f"registers {address}…: a reply of {len(content)} bytes that does not count them right")
    if content[0] != 2 * count:
        raise BadReply("short_replies", f"registers {address}…: {content[0] // 2} came, {count} were asked for")
    return np.frombuffer(content, ">u2", offset=1).astype(np.uint16)
