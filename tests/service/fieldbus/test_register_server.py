"""The register server as another maker's client sees it."""

import asyncio

import numpy as np
import pytest
from pymodbus.client import AsyncModbusTcpClient

from residuum.service.fieldbus.health import SourceHealth
from residuum.service.fieldbus.modbus_client import BadReply, StrictModbusClient
from residuum.service.fieldbus.register_map import float_registers, read_register_map
from residuum.service.fieldbus.register_server import RegisterServer
from residuum.service.fieldbus.settings import MAPS

MAP = read_register_map(MAPS / "process_plant.yaml")
ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE = 1, 2, 3


def with_server(talk):
    """What `talk(server, port, orders)` finds while a server is there."""

    async def run():
        orders = []
        server = RegisterServer(MAP, "127.0.0.1", 0, lambda *order: orders.append(order))
        port = await server.start()
        try:
            return await talk(server, port, orders)
        finally:
            await server.stop()

    return asyncio.run(run())


async def pymodbus_client(port):
    client = AsyncModbusTcpClient("127.0.0.1", port=port, timeout=60, retries=0)
    assert await client.connect()
    return client


def test_another_client_reads_what_is_there_and_switches_faults():
    async def talk(server, port, orders):
        client = await pymodbus_client(port)
        server.memory[1000:1125] = np.arange(125) * 500
        server.show_faults({"sensor-drift": 0.25})
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
    async def talk(server, port, orders):
        client = await pymodbus_client(port)
        answers = [
            await client.read_coils(0, count=1, device_id=1),
            await client.read_holding_registers(65530, count=7, device_id=1),
            await client.write_registers(101, [1, 0, 0], device_id=1),
            await client.write_registers(100, [1, 0], device_id=1),
            await client.write_registers(100, [5, 0, 0], device_id=1),
            await client.read_holding_registers(0, count=2, device_id=1),
        ]
        client.close()
        return [answer.exception_code for answer in answers], orders

    codes, orders = with_server(talk)
    assert codes == [ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_ADDRESS, ILLEGAL_ADDRESS, ILLEGAL_VALUE, 0] and orders == []


def test_what_is_no_modbus_ends_the_connection_and_no_other():
    async def talk(server, port, orders):
        other = await pymodbus_client(port)
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(bytes(range(200, 255)))
        ended = await asyncio.wait_for(reader.read(), 60) == b""
        writer.close()
        short_write = b"\0\1\0\0\0\4\1\x10\0\0"
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(short_write)
        ended &= await asyncio.wait_for(reader.read(), 60) == b""
        writer.close()
        answer = await other.read_holding_registers(0, count=2, device_id=1)
        other.close()
        return ended, answer.registers

    assert with_server(talk) == (True, [0, 0])


def test_many_reads_at_once_are_answered_each_by_its_own():
    async def talk(server, port, orders):
        server.memory[:] = np.arange(1 << 16)
        client = StrictModbusClient("127.0.0.1", port, 1, 60.0, SourceHealth())
        assert await client.connect()
        places = [(100 * k, k + 1) for k in range(16)]
        read = await client.read_all(places)
        client.close()
        with pytest.raises(BadReply, match="connection broke"):
            await client.read(0, 1)
        return all(np.array_equal(words, np.arange(at, at + count)) for words, (at, count) in zip(read, places, strict=True))

    assert with_server(talk)
