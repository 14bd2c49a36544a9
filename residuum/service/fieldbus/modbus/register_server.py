"""RegisterServer: a Modbus TCP device, served by pymodbus (which answers the first of several
requests in one TCP segment).
"""

from __future__ import annotations

from collections.abc import Sequence

from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from residuum.service.fieldbus.modbus.device_reading import DeviceRegisters

_READ, _WRITE = 3, 16


class RegisterServer:
    """A server of a device's registers; port 0 takes a free one. `asked` counts the reads."""

    def __init__(self, registers: DeviceRegisters, host: str, port: int) -> None:
        self._registers, self._address = registers, (host, port)
        self.asked = 0

    async def start(self) -> int:
        """Listen; returns the port. OSError when it is taken."""
        unit = self._registers.unit_id
        space = SimData(0, values=[0] * len(self._registers.memory), datatype=DataType.REGISTERS)
        devices = [SimDevice(unit, space, action=self._answer)]
        if unit:
            devices.append(SimDevice(0, space, action=_no_such_unit))
        self._server = ModbusTcpServer(devices, address=self._address)
        if not await self._server.listen():
            raise OSError(f"cannot listen on {self._address[0]}:{self._address[1]}")
        return int(self._server.transport.sockets[0].getsockname()[1])  # type: ignore[attr-defined]

    async def stop(self) -> None:
        """Stop listening, and end the connections."""
        self._server.close()

    async def _answer(
        self,
        function: int,
        _start: int,
        address: int,
        count: int,
        registers: list[int],
        values: Sequence[int] | None,
    ) -> ExcCodes | None:
        if function == _READ:
            self.asked += 1
            registers[address : address + count] = self._registers.memory[
                address : address + count
            ].tolist()
            return None
        if function != _WRITE:
            return ExcCodes.ILLEGAL_FUNCTION
        if not self._registers.takes_command(address, count):
            return ExcCodes.ILLEGAL_ADDRESS
        return None if self._registers.command(values or ()) else ExcCodes.ILLEGAL_VALUE


async def _no_such_unit(*_request: object) -> ExcCodes:
    return ExcCodes.GATEWAY_NO_RESPONSE
