"""StrictModbusClient: Modbus TCP reads and writes that believe no reply which does not fit its request.

pymodbus accepts replies with fewer registers than asked for and replies whose transaction number is 0, and it begins to
number anew with every connection, so that a gateway's late reply can be taken for the one awaited. Here every reply is held
against its request, transaction numbers begin anywhere, and after a reply that does not fit the connection is given up with
all that may still be under way in it.
"""

from __future__ import annotations

import asyncio
import logging
import random
from collections.abc import Sequence

from pymodbus.client import AsyncModbusTcpClient
from pymodbus.exceptions import ModbusException
from pymodbus.pdu import ExceptionResponse, ModbusPDU
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadHoldingRegistersResponse,
    WriteMultipleRegistersRequest,
    WriteMultipleRegistersResponse,
)

from residuum.service.fieldbus.health import SourceHealth

logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # every failure is counted here; its log would repeat them

_LAST_FIRST_TRANSACTION = 30_000
_HEAD = 6
"""Bytes of a Modbus TCP frame before those that its length field counts."""


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
        The device.
    timeout : float
        For connecting and for each reply [s].
    health : SourceHealth
        Late replies are counted here (they are dropped beneath; nobody else sees them).
    """

    def __init__(self, host: str, port: int, unit_id: int, timeout: float, health: SourceHealth) -> None:
        self._unit_id, self._health = unit_id, health
        self._awaited, self._answered = 0, True
        self._client = AsyncModbusTcpClient(
            host, port=port, timeout=timeout, retries=0, reconnect_delay=0, reconnect_delay_max=0, trace_packet=self._watch
        )
        self._turn = asyncio.Lock()

    async def connect(self) -> bool:
        """Connect once; False when nobody answers."""
        if not await self._client.connect():
            return False
        self._client.ctx.next_tid = random.randint(1, _LAST_FIRST_TRANSACTION)
        return True

    def close(self) -> None:
        """Give the connection up."""
        self._client.close()

    async def read(self, address: int, count: int) -> Sequence[int]:
        """`count` holding registers; BadReply, DeviceRefused, TimeoutError."""
        request = ReadHoldingRegistersRequest(address=address, count=count, dev_id=self._unit_id)
        reply = await self._ask(request)
        if type(reply) is not ReadHoldingRegistersResponse:  # a subclass is the reply to another function
            raise BadReply("corrupt_replies", f"registers {address}…: reply of function {reply.function_code}")
        if len(reply.registers) != count:
            raise BadReply("short_replies", f"registers {address}…: {len(reply.registers)} came, {count} were asked for")
        return reply.registers

    async def write(self, address: int, registers: list[int]) -> None:
        """Write holding registers; BadReply, DeviceRefused, TimeoutError."""
        request = WriteMultipleRegistersRequest(address=address, registers=registers, dev_id=self._unit_id)
        reply = await self._ask(request)
        fits = isinstance(reply, WriteMultipleRegistersResponse) and (reply.address, reply.count) == (address, len(registers))
        if not fits:
            raise BadReply("corrupt_replies", f"registers {address}…: the reply does not confirm what was written")

    async def _ask(self, request: ModbusPDU) -> ModbusPDU:
        async with self._turn:
            try:
                self._awaited, self._answered = self._client.ctx.next_tid + 1, False
                reply: ModbusPDU = await self._client.execute(False, request)
            except ModbusException as error:
                if not self._client.connected:
                    raise BadReply("bus_errors", "the connection broke") from error
                raise TimeoutError(str(error)) from error
            except (AttributeError, OSError) as error:  # pymodbus sends on a transport that has just gone
                raise BadReply("bus_errors", "the connection broke") from error
        if reply.transaction_id != request.transaction_id or (self._unit_id and reply.dev_id != self._unit_id):
            raise BadReply("late_replies", f"reply to request {reply.transaction_id}, {request.transaction_id} was awaited")
        if isinstance(reply, ExceptionResponse):
            raise DeviceRefused(f"exception {reply.exception_code}")
        return reply

    def _watch(self, sending: bool, data: bytes) -> bytes:
        """See every packet: count the replies that nobody awaits, which pymodbus drops in silence."""
        at = 0
        while not sending and len(data) >= at + _HEAD:
            transaction, length = int.from_bytes(data[at : at + 2], "big"), int.from_bytes(data[at + 4 : at + 6], "big")
            at += _HEAD + length
            if len(data) < at:
                break
            if transaction == self._awaited and not self._answered:
                self._answered = True
            elif transaction:
                self._health.count("late_replies", 1, f"a reply to request {transaction} that nobody awaited")
        return data
