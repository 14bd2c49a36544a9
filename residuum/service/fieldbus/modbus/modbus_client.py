"""CheckedModbusClient: pymodbus's client, and no reply believed that does not fit its request.

pymodbus holds back replies of another transaction or unit; it lets through those of transaction 0,
of another function, and with another number of registers than were asked for. After a reply that
does not fit, the connection is to be given up.
"""

from __future__ import annotations

import logging
import random

import numpy as np
from pymodbus.client import AsyncModbusTcpClient
from pymodbus.exceptions import ConnectionException, ModbusIOException
from pymodbus.pdu import ModbusPDU
from pymodbus.pdu.bit_message import ReadCoilsRequest, ReadDiscreteInputsRequest
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadInputRegistersRequest,
    WriteMultipleRegistersRequest,
)

from residuum.service.fieldbus.modbus.channel_registers import (
    OF_BITS,
    Function,
    Registers,
    explained,
)

# Well below 65 000, where pymodbus begins again at 1.
_LAST_FIRST_TRANSACTION = 30_000
_READS: dict[Function, type[ModbusPDU]] = {
    "holding": ReadHoldingRegistersRequest,
    "input": ReadInputRegistersRequest,
    "coils": ReadCoilsRequest,
    "discrete": ReadDiscreteInputsRequest,
}


class BadReply(Exception):
    """A reply that must not be believed, or none; `counter` names the loss counter it belongs
    to.
    """

    def __init__(self, counter: str, message: str) -> None:
        super().__init__(message)
        self.counter = counter


class DeviceRefused(Exception):
    """The device answered with a Modbus exception; the connection is in order."""


class CheckedModbusClient:
    """One connection to one device; unit 0 takes replies of any.

    `timeout` is for connecting and for each reply [s]; advice counts registers from `address_base`.
    """

    def __init__(
        self, host: str, port: int, unit_id: int, timeout: float, address_base: int = 0
    ) -> None:
        self._client = AsyncModbusTcpClient(
            host, port=port, timeout=timeout, retries=0, reconnect_delay=0
        )
        self._unit, self._base = unit_id, address_base

    async def connect(self) -> None:
        """Connect once. Transactions begin anywhere: a reply to an earlier connection must not seem
        to be one to this.
        """
        if not await self._client.connect():
            raise BadReply("bus_errors", "nobody answers at this address")
        self._client.ctx.next_tid = random.randint(1, _LAST_FIRST_TRANSACTION)

    def close(self) -> None:
        """Give the connection up."""
        self._client.close()

    async def read(self, address: int, count: int, function: Function = "holding") -> Registers:
        """`count` registers, or coils as 0 and 1, from an address on the wire; BadReply,
        DeviceRefused.
        """
        reply = await self._ask(
            _READS[function](address=address, count=count, dev_id=self._unit), function
        )
        # bits come in whole bytes, those behind the last one asked for as 0
        received, due = (
            (reply.bits, -(-count // 8) * 8) if function in OF_BITS else (reply.registers, count)
        )
        if len(received) != due:
            raise BadReply(
                "short_replies", f"{function} {address}…: {len(received)} came, {due} were due"
            )
        return np.array(received[:count], np.uint16)

    async def write(self, address: int, registers: list[int]) -> None:
        """Write holding registers; BadReply, DeviceRefused."""
        reply = await self._ask(
            WriteMultipleRegistersRequest(address=address, registers=registers, dev_id=self._unit),
            "holding",
        )
        if (reply.address, reply.count) != (address, len(registers)):
            raise BadReply(
                "corrupt_replies",
                f"registers {address}…: the reply does not confirm what was written",
            )

    async def _ask(self, request: ModbusPDU, function: Function) -> ModbusPDU:
        try:
            reply = await self._client.execute(False, request)
        except ConnectionException:
            raise BadReply("bus_errors", "the connection broke") from None
        except ModbusIOException as error:
            raise BadReply("timeouts", str(error)) from None
        # transaction 0 passes pymodbus, and what is left in its buffer answers no request of ours
        if reply.transaction_id != request.transaction_id or self._client.ctx.recv_buffer:
            raise BadReply("late_replies", "a reply that nobody awaited")
        if reply.isError():
            raise DeviceRefused(
                explained(
                    reply.exception_code, function, request.address, request.count, self._base
                )
            )
        if reply.function_code != request.function_code:
            raise BadReply(
                "corrupt_replies",
                f"reply of function {reply.function_code}, not {request.function_code}",
            )
        return reply


logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # the counters say it
