"""pymodbus carries every Modbus byte: with its transport replaced and sockets forbidden, all traffic is seen and all works."""

import ast
import asyncio
import socket
import struct
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from pymodbus.transport import ModbusProtocol

import residuum.service.fieldbus
from residuum.service.fieldbus.modbus.device_reading import DeviceRegisters, read_device
from residuum.service.fieldbus.modbus.modbus_source import ModbusSource
from residuum.service.fieldbus.modbus.register_map import read_register_map
from residuum.service.fieldbus.modbus.register_server import RegisterServer
from residuum.service.fieldbus.settings import MAPS

MAP = read_register_map(MAPS / "process_plant.yaml")
PORT = 502


class End:
    """One end of a connection in memory: what is written at one comes out at the other, and is noted."""

    def __init__(self, wire, direction):
        self.wire, self.direction, self.loop = wire, direction, asyncio.get_running_loop()
        self.protocol = self.other = None

    def write(self, data):
        self.wire.traffic.append((self.direction, bytes(data)))
        self.other.loop.call_soon_threadsafe(lambda: self.other.protocol.data_received(bytes(data)))

    def close(self):
        pass

    abort = close

    def is_closing(self):
        return False

    def get_extra_info(self, _name, default=None):
        return default


class Wire:
    """Connections of pymodbus in memory, between any threads, instead of sockets."""

    def __init__(self, monkeypatch):
        self.traffic, self.listener = [], None
        wire = self

        async def listen(protocol):
            wire.listener, wire.loop = protocol, asyncio.get_running_loop()
            protocol.transport = SimpleNamespace(
                sockets=[SimpleNamespace(getsockname=lambda: ("memory", PORT))], close=lambda: None
            )
            return True

        async def connect(protocol):
            ours = End(wire, "request")
            ours.protocol = protocol

            async def accept():
                theirs = End(wire, "reply")
                theirs.protocol, theirs.other, ours.other = (
                    wire.listener.handle_new_connection(),
                    ours,
                    theirs,
                )
                theirs.protocol.connection_made(theirs)

            await asyncio.wrap_future(asyncio.run_coroutine_threadsafe(accept(), wire.loop))
            protocol.connection_made(ours)
            return True

        monkeypatch.setattr(ModbusProtocol, "listen", listen)
        monkeypatch.setattr(ModbusProtocol, "connect", connect)
        for forbidden in ("connect", "connect_ex", "bind", "listen", "sendto"):
            monkeypatch.setattr(socket.socket, forbidden, self._refuse)

    @staticmethod
    def _refuse(*_arguments):
        raise AssertionError("a socket of our own")

    def frames(self, direction):
        """The Modbus TCP frames that went in a direction: function and length, each frame whole."""
        data, frames = b"".join(each for way, each in self.traffic if way == direction), []
        while data:
            _, protocol, length = struct.unpack(">HHH", data[:6])
            assert protocol == 0 and len(data) >= 6 + length
            frames.append((data[7], length))
            data = data[6 + length :]
        return frames


@pytest.fixture
def wire(monkeypatch):
    return Wire(monkeypatch)


async def until(condition):
    end = time.monotonic() + 120
    while not condition() and time.monotonic() < end:
        await asyncio.sleep(0.01)
    assert condition()


def test_all_modbus_traffic_goes_through_the_transport_of_pymodbus(wire):
    orders, blocks = [], []

    async def talk():
        device = DeviceRegisters(MAP, lambda *order: orders.append(order))
        server = RegisterServer(device, "memory", PORT)
        assert await server.start() == PORT
        source = ModbusSource(
            "memory", PORT, MAP, lambda block: blocks.append(block) or True, timeout=60.0
        )
        device.pages["process"].append({"u": np.arange(200.0), "y": np.arange(200.0) * 2})
        source.start()
        await until(lambda: sum(block.n for block in blocks) == 200)
        await asyncio.to_thread(source.switch_fault, "sensor-drift", 0.5)
        readings, refusals = await asyncio.to_thread(read_device, "memory", PORT, MAP, 60.0)
        source.stop()
        await asyncio.to_thread(source.join)
        await server.stop()
        return readings, refusals

    readings, refusals = asyncio.run(talk())
    read = np.concatenate([block.channels["y"] for block in blocks])
    assert np.array_equal(read, np.arange(200.0) * 2) and orders == [("sensor-drift", 0.5)]
    assert not refusals and {each.channel: each.value for each in readings} == {
        "u": 199.0,
        "y": 398.0,
    }
    requests, replies = wire.frames("request"), wire.frames("reply")
    # every request has its reply, and nothing else went over the wire
    assert len(requests) == len(replies) >= 8
    assert (
        {function for function, _ in requests} == {function for function, _ in replies} == {3, 16}
    )


OWN_PROTOCOL = ("can/can_bus", "can/frame_batch", "modbus/modbus_client", "modbus/register_server")
"""What speaks to the libraries of buses; the rest of the room is addresses, maps, layouts, counters, replay and sources."""


def statements(path):
    """Statements without docstrings: a line that is broken in two is no more code."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return sum(
        isinstance(node, ast.stmt)
        and not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant))
        for node in ast.walk(tree)
    )


def test_little_code_of_ours_stands_between_the_libraries_of_buses_and_the_maps():
    room = Path(residuum.service.fieldbus.__file__).parent
    assert sum(statements(room / f"{name}.py") for name in OWN_PROTOCOL) <= 175
    for path in room.rglob("*.py"):
        names = {
            node.id
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            if isinstance(node, ast.Name)
        }
        opens = names & {"struct", "socketserver"} if path.stem != "sparkplug_payload" else set()
        assert not opens and ("socket" not in names or path.stem == "can_bus"), (
            f"{path.name} has a protocol of its own"
        )
