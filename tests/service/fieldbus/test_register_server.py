"""The register server as a client sees it."""

import asyncio

import numpy as np
import pytest
from pymodbus.client import AsyncModbusTcpClient

from residuum.service.fieldbus.modbus.device_reading import DeviceRegisters
from residuum.service.fieldbus.modbus.register_map import float_registers, read_register_map
from residuum.service.fieldbus.modbus.register_server import RegisterServer
from residuum.service.fieldbus.settings import MAPS

MAP = read_register_map(MAPS / "process_plant.yaml")
ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE, NO_SUCH_UNIT = 1, 2, 3, 11


def with_server(talk):
    """What `talk(registers, port, orders)` finds while a server of these registers is there."""

    async def run():
        orders = []
        registers = DeviceRegisters(MAP, lambda *order: orders.append(order))
        server = RegisterServer(registers, "127.0.0.1", 0)
        port = await server.start()
        try:
            return await talk(registers, port, orders)
        finally:
            await server.stop()

    return asyncio.run(run())


async def pymodbus_client(port):
    client = AsyncModbusTcpClient("127.0.0.1", port=port, timeout=60, retries=0)
    assert await client.connect()
    return client


def test_another_client_reads_what_is_there_and_switches_faults():
    async def talk(registers, port, orders):
        client = await pymodbus_client(port)
        registers.memory[1000:1125] = np.arange(125) * 500
        registers.show_faults({"sensor-drift": 0.25})
        read = (await client.read_holding_registers(1000, count=125, device_id=1)).registers
        state = (await client.read_holding_registers(112, count=2, device_id=1)).registers
        last = (await client.read_holding_registers(65535, count=1, device_id=1)).registers
        wrote = await client.write_registers(100, [2, *float_registers(0.5)], device_id=1)
        client.close()
        return read, state, last, wrote.isError(), orders

    read, state, last, refused, orders = with_server(talk)
    assert read == [500 * k for k in range(125)] and state == float_registers(0.25) and last == [0]
    assert not refused and orders == [("sensor-drift", 0.5)]


def test_requests_that_make_no_sense_are_refused_by_number():
    async def talk(registers, port, orders):
        client = await pymodbus_client(port)
        answers = [
            await client.read_coils(0, count=1, device_id=1),
            await client.read_holding_registers(65530, count=7, device_id=1),
            await client.write_registers(101, [1, 0, 0], device_id=1),
            await client.write_registers(100, [1, 0], device_id=1),
            await client.write_registers(100, [5, 0, 0], device_id=1),
            await client.read_holding_registers(0, count=2, device_id=2),
            await client.read_holding_registers(0, count=2, device_id=1),
        ]
        client.close()
        return [answer.exception_code for answer in answers], orders

    codes, orders = with_server(talk)
    assert (
        codes
        == [
            ILLEGAL_FUNCTION,
            ILLEGAL_ADDRESS,
            ILLEGAL_ADDRESS,
            ILLEGAL_ADDRESS,
            ILLEGAL_VALUE,
            NO_SUCH_UNIT,
            0,
        ]
        and orders == []
    )


def test_what_is_no_modbus_disturbs_no_other_connection():
    async def talk(registers, port, orders):
        other = await pymodbus_client(port)
        short_write = b"\0\1\0\0\0\4\1\x10\0\0"
        writers = []
        for nonsense in (bytes(range(200, 255)), short_write, bytes(5000)):
            _, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(nonsense)
            writers.append(writer)
        answer = await other.read_holding_registers(0, count=2, device_id=1)
        other.close()
        for writer in writers:
            writer.close()
        return answer.registers, orders

    assert with_server(talk) == ([0, 0], [])


def test_a_port_that_is_taken_is_told():
    async def talk(registers, port, orders):
        with pytest.raises(OSError, match=f"127.0.0.1:{port}"):
            await RegisterServer(registers, "127.0.0.1", port).start()

    with_server(talk)
