"""A device of every kind of source, for the conformance test of sources.

A new kind of source is a class here and its name in `RIGS`. It says what its device does when samples are sent, when one is bad,
when the device begins anew and when nobody can reach it; what its protocol does not have stands in `lacks`, with the reason.
"""

import asyncio
import gc
import json
import math
import threading
import time
import uuid
from abc import ABC, abstractmethod
from dataclasses import replace
from datetime import UTC, datetime
from typing import ClassVar

import can
import numpy as np
import pytest
import yaml

from residuum.service.broker import BrokerAddress, broker_address
from residuum.service.fieldbus import SOURCES
from residuum.service.fieldbus.can.can_bus import open_bus
from residuum.service.fieldbus.can.frame_batch import BUS_OFF
from residuum.service.fieldbus.can.frame_layout import read_dbc
from residuum.service.fieldbus.modbus.register_map import build_page, read_register_map
from residuum.service.fieldbus.settings import SourceSettings
from tests.service.fieldbus.faulty_modbus import FaultyModbus

UNITS = {"u": "V", "y": "m"}
PATIENCE = 60.0
"""[s] No condition takes nearly so long, not even on a busy machine."""
SAY_WHY = "write it, or say in `lacks` why the protocol has no such thing"
WRONG = 7777.7
"""What stands in a value that must not be believed: no sample has it."""
NO_VALUE = 65535
"""A raw number that says that there is no value."""
_SET_BACK = -3600.0
"""[s] By which a device's clock is wrong after it began anew."""


def truth(k):
    """What sample `k` holds; the channels tell which sample it is."""
    return {"u": 0.5 * k, "y": 100.0 - 0.25 * k}


def sample_of(channel, values):
    """Which samples have these values of a channel; NaN where there is none."""
    return values / 0.5 if channel == "u" else (100.0 - values) / 0.25


def wait(condition, seconds=PATIENCE):
    """Whether the condition holds within these seconds."""
    end = time.monotonic() + seconds
    while not (holds := condition()) and time.monotonic() < end:
        time.sleep(0.01)
    return holds


class Rig(ABC):
    """A device, and a source that reads one stream of it.

    The device numbers its samples itself: sample `k` is taken at `k` sample times of its clock and holds `truth(k)`; `next` is
    the one that comes next. What the sink took is in `taken`, what found no room in `refused`.

    `lacks` is of each step (`late`, `repeat`, …) that the protocol does not have why; `counts` of each step the counters that it
    moves; `clock` says whether samples carry their place (else the reader's clock places them).
    """

    kind: str
    sample_time: float
    lacks: ClassVar = {}
    counts: ClassVar = {}
    clock = True

    def __init__(self, folder, fixture):
        self.folder, self.fixture = folder, fixture
        self.taken, self.refused, self.room, self.next = [], [], True, 0
        self.source, self.begun, self.ended = None, False, False

    # what a kind says

    @abstractmethod
    def map_text(self):
        """The map of the stream: channels u [V] and y [m], a sample every `sample_time`."""

    @abstractmethod
    def begin(self):
        """Start the device; gives the fields of `SourceSettings` by which it is reached."""

    @abstractmethod
    def nowhere(self):
        """The fields of an address where nobody is."""

    @abstractmethod
    def put(self, numbers):
        """Send these samples, in this order: a number that is left out is not sent, one that is there twice is repeated."""

    def put_late(self, numbers):
        """Send these samples, one of them behind the one that follows it."""
        turned = list(numbers)
        turned[1], turned[2] = turned[2], turned[1]
        self.put(turned)

    def put_bad(self, k):
        """Send a sample of which u is no number, or cannot be believed."""
        raise NotImplementedError(SAY_WHY)

    def put_wrong_type(self, k):
        """Send a sample of which u is not of the type that it should be."""
        raise NotImplementedError(SAY_WHY)

    def put_no_value(self, k):
        """Send a sample of which u says itself that there is no value: a code for it, or an infinite number."""
        raise NotImplementedError(SAY_WHY)

    def begin_anew(self):
        """Set the device's clock or counter back."""
        raise NotImplementedError(SAY_WHY)

    @abstractmethod
    def cut(self):
        """Break the connection."""

    @abstractmethod
    def restore(self):
        """Let the connection be made again."""

    def catch_up(self):  # noqa: B027
        """The device's clock went on while nothing was sent: the sample that comes next is the one of now."""

    def close(self):  # noqa: B027
        """End the device, where it has begun; the connection may be broken."""

    # what the test does

    def open(self, reach):
        """Open the source as the service does, by the address that `reach` (`begin`, `nowhere`) gives."""
        file = self.folder / "map"
        file.write_text(self.map_text())
        settings = SourceSettings(kind=self.kind, map=str(file), **reach())
        self.begun = reach == self.begin
        self.source = SOURCES[self.kind](settings, self._take)
        self.source.start()

    def start(self):
        """Device and source, and the first samples have come."""
        self.open(self.begin)
        self.flow()

    def _take(self, block):
        has_room = self.room
        (self.taken if has_room else self.refused).append(block)
        return has_room

    def newest(self):
        """The newest sample that reached the sink."""
        blocks = [*self.taken, *self.refused]
        samples = [sample_of(name, b.channels[name]) for b in blocks for name in UNITS]
        return max((s[~np.isnan(s)].max() for s in samples if not np.isnan(s).all()), default=-1)

    def flow(self):
        """Send samples until the newest one comes through."""
        end, patience = time.monotonic() + PATIENCE, 0.1
        while True:
            self.put([self.next])
            self.next += 1
            if wait(lambda: self.newest() >= self.next - 1, patience):
                return
            patience *= 1.5
            assert time.monotonic() < end, f"no sample comes through: {self.health()}"

    def send(self, count, leave_out=()):
        """Send so many samples more, but for some of them, and wait until the newest has come; gives their numbers."""
        numbers = [k for k in range(self.next, self.next + count) if k - self.next not in leave_out]
        self.next += count
        self.put(numbers)
        assert wait(lambda: self.newest() >= numbers[-1]), self.health()
        return numbers

    def health(self):
        return self.source.health.snapshot()

    def counted(self):
        return {name: times for name, times in self.health()["counters"].items() if times}

    def end(self):
        """End the source, then the device; once."""
        if self.ended:
            return
        self.ended = True
        if self.source is not None:
            self.source.stop()
            self.source.join(PATIENCE)
        if self.begun:
            self.close()


class CanRig(Rig):
    """Frames with a counter of 8 bits on a virtual bus."""

    kind = "can"
    sample_time = 1.0  # so slow that a pause of a busy machine hides no turn of the counter
    lacks: ClassVar = {
        "wrong type": "a CAN frame carries bits; what type they have, its DBC file alone says"
    }
    counts: ClassVar = {
        "gap": {"lost"},
        "repeat": {"duplicated"},
        "late": {"reordered"},
        "no value": {"no_value"},
        "bad": {"undecodable"},
        "anew": {"counter_jumps"},
        "cut": {"bus_errors", "reconnects"},
        "nowhere": {"bus_errors"},
    }

    def map_text(self):
        return (
            'VERSION ""\nBS_:\nBU_: A\nBO_ 256 machine: 5 A\n SG_ u : 0|16@1+ (0.5,0) [0|0] "V" A\n'
            ' SG_ y : 16|16@1- (0.25,100) [0|0] "m" A\n SG_ counter : 32|8@1+ (1,0) [0|255] "" A\n'
            f'BA_DEF_ BO_ "SampleTime" FLOAT 0 1000;\nBA_ "SampleTime" BO_ 256 {self.sample_time};\n'
            f'VAL_ 256 u {NO_VALUE} "not available";\n'
        )

    def begin(self):
        self.channel, self.first = f"virtual:{uuid.uuid4()}", 0
        self.bus = open_bus(self.channel)
        return {"channel": self.channel}

    def nowhere(self):
        return {"channel": "socketcan:no_such_can7"}

    def put(self, numbers):
        layout = read_dbc(self.folder / "map")["machine"]
        numbers = np.asarray(numbers)
        self.bus.send_many(256, layout.encode((numbers - self.first) % 256, truth(numbers)))

    def put_bad(self, k):
        self.bus.send(256, b"123")  # too short

    def put_no_value(self, k):
        layout = read_dbc(self.folder / "map")["machine"]
        self.bus.send_many(
            256, layout.encode([(k - self.first) % 256], truth(k) | {"u": 0.5 * NO_VALUE})
        )

    def begin_anew(self):
        self.first = self.next + 128  # half a turn away: neither losses nor repetitions explain it

    def cut(self):
        self.bus._bus.send(can.Message(arbitration_id=BUS_OFF, is_error_frame=True))

    def restore(self):
        pass  # the bus is opened again as soon as it is tried

    def close(self):
        self.bus.close()


class ModbusRig(Rig):
    """What pages and plain registers have in common: a server that can be told to answer wrongly."""

    kind = "modbus"
    lacks: ClassVar = {
        "late": "a Modbus device is asked: it sends nothing that could come late",
        "wrong type": "registers carry bits; what type they have, the register map alone says",
    }

    def begin(self):
        self.device = FaultyModbus(iter(()))
        self.stream = read_register_map(self.folder / "map").streams["machine"]
        return {"port": self.device.port}

    def nowhere(self):
        return {"port": self.fixture("free_port")()}

    def cut(self):
        self.device.cut()

    def restore(self):
        self.device.restore()

    def close(self):
        self.device.stop()

    def channels(self):
        return {
            "u": {"register": 0, "type": "uint16", "scale": 0.5, "unit": "V", "missing": NO_VALUE},
            "y": {"register": 1, "type": "int16", "scale": 0.25, "offset": 100.0, "unit": "m"},
        }

    def registers(self, k, u=None):
        values = truth(k) if u is None else truth(k) | {"u": u}
        return self.stream.encode({name: [value] for name, value in values.items()})


class PagedModbusRig(ModbusRig):
    """A device that keeps its newest samples in a ring of pages."""

    sample_time = 0.02
    counts: ClassVar = {
        "gap": {"lost"},
        "repeat": {"late_replies", "reconnects"},
        "no value": {"no_value"},
        "bad": {"corrupt_replies"},
        "anew": {"counter_jumps"},
        "cut": {"bus_errors", "reconnects"},
        "nowhere": {"bus_errors"},
    }
    RING, HELD = 32, 30
    """Pages, and those of them that a reader takes."""

    def map_text(self):
        pages = {"newest": 0, "address": 1000, "stride": 5, "count": self.RING, "samples": 1}
        stream = {"sample_time": self.sample_time, "pages": pages, "channels": self.channels()}
        return yaml.safe_dump({"streams": {"machine": stream}})

    def begin(self):
        self.first = self.made = 0
        return super().begin()

    def put(self, numbers):
        if len(set(numbers)) < numbers[-1] + 1 - self.made:
            self._overrun(numbers[0])
        while self.made <= numbers[-1]:
            self._make(min(self.made + self.HELD, numbers[-1] + 1))
            wait(
                lambda: self.newest() >= self.made - 1, 0.0 if self.made > numbers[-1] else PATIENCE
            )
        if len(set(numbers)) < len(numbers):
            self.device.faults = iter(["twice"])

    def _overrun(self, following):
        """Nobody reads before the ring has gone round, so that the sample `following` is the oldest in it."""
        self._make(following + self.HELD)
        wait(lambda: self.newest() >= self.made - 1)

    def _make(self, end):
        """Write the pages of the samples up to `end`, then show them all at once."""
        for k in range(self.made, end):
            self._write(k, self.registers(k))
        self.made = end
        self.device.memory[0:2] = (0, self.made - self.first)

    def _write(self, k, registers):
        page = build_page(k - self.first, registers)
        begin = 1000 + 5 * ((k - self.first) % self.RING)
        self.device.memory[begin : begin + 5] = page
        return begin

    def put_bad(self, k):
        """A page that does not fit its checksum, as when it is read while it is written; then it is whole."""
        self._write(k, self.registers(k))
        u = 1000 + 5 * ((k - self.first) % self.RING) + 3
        self.device.memory[u] = round(WRONG)
        self.made = k + 1
        self.device.memory[0:2] = (0, self.made - self.first)
        wait(lambda: "corrupt_replies" in self.counted())
        self._write(k, self.registers(k))

    def put_no_value(self, k):
        self._write(k, self.registers(k, u=math.nan))
        self.made = k + 1
        self.device.memory[0:2] = (0, self.made - self.first)

    def begin_anew(self):
        self.first = self.made = self.next
        self.device.memory[0:2] = 0


class PolledModbusRig(ModbusRig):
    """A device whose plain registers are read once a sample time: its clock is the reader's."""

    sample_time = 0.05
    clock = False
    lacks: ClassVar = ModbusRig.lacks | {
        "anew": "plain registers have neither clock nor counter that could be set back"
    }
    counts: ClassVar = {
        "gap": {"timeouts", "reconnects", "lost"},
        "repeat": {"late_replies", "reconnects"},
        "no value": {"no_value"},
        "bad": {"modbus_exceptions"},
        "cut": {"bus_errors", "reconnects"},
        "nowhere": {"bus_errors"},
    }

    def map_text(self):
        stream = {
            "sample_time": self.sample_time,
            "poll": {"address": 40},
            "channels": self.channels(),
        }
        return yaml.safe_dump({"streams": {"machine": stream}})

    def begin(self):
        self.last = -1
        return super().begin()

    def put(self, numbers):
        for k in numbers:
            if k > self.last + 1:
                self.device.faults = iter(["silence"])
            elif k == self.last:
                self.device.faults = iter(["twice"])
            self.last = k
            self.device.memory[40:42] = self.registers(k)
            wait(lambda k=k: self.newest() >= k, 0.0 if k == numbers[-1] else PATIENCE)

    def put_bad(self, k):
        self.device.faults = iter(["exception"])
        self.put([k])

    def put_no_value(self, k):
        self.device.memory[40:42] = self.registers(k, u=math.nan)
        wait(lambda: "no_value" in self.counted())


class StampedRig(Rig):
    """Values that carry the time at which they were taken, on a clock of the device."""

    sample_time = 0.02

    def __init__(self, *given):
        super().__init__(*given)
        self.origin, self.behind = time.time(), None

    def stamp(self, k):
        """When sample `k` was taken [s since 1970]."""
        return self.origin + k * self.sample_time

    def flow(self):
        super().flow()
        self._note()

    def send(self, count, leave_out=()):
        numbers = super().send(count, leave_out)
        self._note()
        return numbers

    def _note(self):
        """How far the stamps are behind our clock: a source tells a clock that was set by how this changes."""
        self.behind = time.time() - self.stamp(self.next - 1)

    def catch_up(self):
        if self.behind is not None:
            now = (time.time() - self.behind - self.origin) / self.sample_time
            self.next = max(self.next, math.ceil(now))

    def set_back(self):
        self.origin, self.behind = self.origin + _SET_BACK, None

    @staticmethod
    def raw(k):
        """The values before scale and offset of the map."""
        return {"u": float(k), "y": -float(k)}

    @staticmethod
    def scaled(key, names):
        return {
            "u": {key: names["u"], "unit": "V", "scale": 0.5},
            "y": {key: names["y"], "unit": "m", "scale": 0.25, "offset": 100.0},
        }


class _OpcuaServer:
    """A server in a thread; it takes seconds to make, so that all tests have the same, with nodes of their own."""

    def __init__(self, port):
        self.url = f"opc.tcp://127.0.0.1:{port}/"
        self._ready, self._ended = threading.Event(), asyncio.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), daemon=True)
        self._thread.start()
        assert self._ready.wait(PATIENCE)

    async def _serve(self):
        from asyncua import Server, ua

        self._loop, self._ua = asyncio.get_running_loop(), ua
        self._server = Server()
        await self._server.init()
        self._server.set_endpoint(self.url)
        self._server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        await self._server.register_namespace("urn:rig")
        async with self._server:
            self._ready.set()
            await self._ended.wait()

    def do(self, work):
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(PATIENCE)

    async def add(self, node):
        identifier = self._ua.NodeId(node, 2)
        await self._server.nodes.objects.add_variable(identifier, f"2:{node}", 0.0)

    async def write(self, node, datum):
        identifier = self._ua.NodeId(node, 2)
        # a value of another type than the one before is refused, but where values come from a function
        self._server.set_attribute_value_callback(identifier, lambda *_: datum)
        await self._server.write_attribute_value(identifier, datum)

    async def drop(self):
        """Break all connections; they may be made again at once."""
        for client in list(self._server.bserver.clients):
            client.transport.abort()

    async def cut(self):
        await self.drop()
        await self._server.bserver.stop()

    async def restore(self):
        await self._server.bserver.start()

    def close(self):
        self._loop.call_soon_threadsafe(self._ended.set)
        self._thread.join(PATIENCE)
        gc.collect()  # what a loop leaves is collected here, not in the middle of another test


class OpcuaRig(StampedRig):
    """Two nodes of a server."""

    kind = "opcua"
    lacks: ClassVar = {}
    counts: ClassVar = {
        "gap": {"lost"},
        "repeat": {"reconnects"},
        "no value": {"no_value"},
        "bad": {"bad_status"},
        "wrong type": {"bad_status"},
        "anew": {"counter_jumps"},
        "cut": {"bus_errors", "reconnects"},
        "nowhere": {"bus_errors"},
    }

    def __init__(self, *given):
        super().__init__(*given)
        self.nodes, self.away = {name: f"{uuid.uuid4()}.{name}" for name in UNITS}, False

    def map_text(self):
        names = {name: f"ns=2;s={node}" for name, node in self.nodes.items()}
        channels = self.scaled("node", names)
        for channel in channels.values():
            channel["held"] = False  # each sample has a report of its own
        stream = {"sample_time": self.sample_time, "channels": channels}
        return yaml.safe_dump({"streams": {"machine": stream}})

    def begin(self):
        self.ua = pytest.importorskip("asyncua").ua
        self.server = self.fixture("lasting")(_OpcuaServer, self.fixture("free_port")())
        self.server.do(self._begin())
        return {"channel": self.server.url}

    def nowhere(self):
        return {"channel": f"opc.tcp://127.0.0.1:{self.fixture('free_port')()}/"}

    async def _begin(self):
        for name, node in self.nodes.items():
            await self.server.add(node)
            bad = self.ua.StatusCodes.BadWaitingForInitialData
            await self._write(name, 0.0, self.next - 1, bad)

    async def _write(self, name, value, k, status=0):
        at = datetime.fromtimestamp(self.stamp(k), UTC)
        status = self.ua.StatusCode(status)
        await self.server.write(
            self.nodes[name], self.ua.DataValue(self.ua.Variant(value), status, SourceTimestamp=at)
        )

    async def _write_samples(self, numbers, names):
        for k in numbers:
            for name in names:
                await self._write(name, self.raw(k)[name], k)

    def put(self, numbers):
        self.server.do(self._write_samples(sorted(set(numbers)), UNITS))
        if len(set(numbers)) < len(numbers):  # a session that is opened anew is told it again
            self.server.do(self.server.drop())

    def put_late(self, numbers):
        """Of a node, values come in order; those of one node may come behind those of another."""
        self.server.do(self._write_samples(numbers, ["u"]))
        self.server.do(self._write_samples(numbers, ["y"]))

    def _write_other(self, k, value, status=0):
        self.server.do(self._write("u", value, k, status))
        self.server.do(self._write("y", self.raw(k)["y"], k))

    def put_bad(self, k):
        self._write_other(k, WRONG, self.ua.StatusCodes.UncertainLastUsableValue)

    def put_wrong_type(self, k):
        self._write_other(k, f"{WRONG}")

    def put_no_value(self, k):
        self._write_other(k, math.inf)

    def begin_anew(self):
        self.set_back()

    def cut(self):
        self.server.do(self.server.cut())
        self.away = True

    def restore(self):
        self.server.do(self.server.restore())
        self.away = False
        self.catch_up()

    def close(self):
        if self.away:
            self.restore()


class _Wire(BrokerAddress):
    """A broker's address; data messages of whoever enters it are held back where `held` is a list."""

    held = None

    def client(self, **options):
        client = super().client(**options)
        self.publish, client.publish = client.publish, self._publish
        return client

    def _publish(self, topic, content, **options):
        if self.held is None or "/DDATA/" not in topic:
            return self.publish(topic, content, **options)
        self.held.append((topic, content))
        return None


class SparkplugRig(StampedRig):
    """Two metrics of an edge node's device, over a real broker."""

    kind = "sparkplug"
    counts: ClassVar = {
        "gap": {"lost"},
        "repeat": {"duplicated"},
        "no value": {"no_value"},
        "bad": {"bad_status"},
        "wrong type": {"bad_status"},
        "anew": {"counter_jumps"},
        "cut": {"bus_errors", "reconnects"},
        "nowhere": {"bus_errors"},
    }

    def map_text(self):
        channels = self.scaled("metric", {"u": "Motor/u", "y": "Motor/y"})
        stream = {"device": "Drive", "sample_time": self.sample_time, "channels": channels}
        return yaml.safe_dump({"node": "Plant/Press", "streams": {"machine": stream}})

    def begin(self):
        reason = "the extra 'sparkplug' is not installed: Sparkplug was not tried"
        pytest.importorskip("google.protobuf", reason=reason)
        self.port = self.fixture("free_port")()
        self.restore()
        self._enter()
        return {"channel": f"mqtt://127.0.0.1:{self.port}"}

    def nowhere(self):
        return {"channel": f"mqtt://127.0.0.1:{self.fixture('free_port')()}"}

    def _enter(self):
        from residuum.service.finding_metrics import EdgeNode

        self.wire = _Wire(*broker_address(f"mqtt://127.0.0.1:{self.port}"))
        self.node = EdgeNode(self.wire, "Plant/Press")
        self._write(self.next - 1, self.raw(self.next - 1))
        self.node.start()

    def _write(self, k, values):
        named = {f"Motor/{name}": value for name, value in values.items()}
        self.node.write("Drive", named, self.stamp(k))

    def _messages(self, numbers):
        """What the node sends of these samples, held back; nothing while it is not connected."""
        self.wire.held = []
        for k in numbers:
            self._write(k, self.raw(k))
        held, self.wire.held = self.wire.held, None
        return dict(zip(numbers, held, strict=False))

    def put(self, numbers):
        messages = self._messages(sorted(set(numbers)))
        for k in numbers:
            if k in messages:
                self.wire.publish(*messages[k])

    def put_bad(self, k):
        from residuum.service.fieldbus.sparkplug.sparkplug_payload import pack, unpack

        (topic, content) = self._messages([k])[k]
        payload = unpack(content)
        u, *rest = payload.metrics
        spoilt = replace(u, value=WRONG, good=False)
        self.wire.publish(topic, pack(replace(payload, metrics=[spoilt, *rest])))

    def put_wrong_type(self, k):
        self._write(k, self.raw(k) | {"u": f"{WRONG}"})

    def put_no_value(self, k):
        self._write(k, self.raw(k) | {"u": math.inf})

    def begin_anew(self):
        self.node.stop()
        self.set_back()
        self._enter()

    def cut(self):
        self.broker.terminate()
        self.broker.wait(PATIENCE)

    def restore(self):
        self.broker = self.fixture("start_mosquitto")(self.port)
        self.catch_up()

    def close(self):
        self.node.stop()


class MqttRig(StampedRig):
    """A device that publishes JSON messages, over a real broker."""

    kind = "mqtt"
    lacks: ClassVar = {}
    counts: ClassVar = {
        "gap": {"lost"},
        "repeat": {"duplicated"},
        "no value": {"no_value"},
        "bad": {"undecodable"},
        "wrong type": {"bad_status"},
        "anew": {"counter_jumps"},
        "cut": {"bus_errors", "reconnects"},
        "nowhere": {"bus_errors"},
    }

    def map_text(self):
        channels = self.scaled("path", {name: f"/values/0/{name}" for name in UNITS})
        stream = {
            "sample_time": self.sample_time,
            "topic": "rig/+",
            "time": {"path": "at", "form": "ms"},
            "channels": channels,
        }
        return yaml.safe_dump({"streams": {"machine": stream}})

    def begin(self):
        reason = "the extra 'mqtt' is not installed: JSON over MQTT was not tried"
        pytest.importorskip("paho.mqtt.client", reason=reason)
        self.port = self.fixture("free_port")()
        address = broker_address(f"mqtt://127.0.0.1:{self.port}")
        self.client = address.client()
        self.client.reconnect_delay_set(1, 1)
        self.client.connect_async(address.host, address.port)
        self.restore()
        self.client.loop_start()
        return {"channel": f"mqtt://127.0.0.1:{self.port}"}

    def nowhere(self):
        pytest.importorskip("paho.mqtt.client")
        return {"channel": f"mqtt://127.0.0.1:{self.fixture('free_port')()}"}

    def publish(self, k, values):
        content = json.dumps({"at": 1e3 * self.stamp(k), "values": [values]})
        self.client.publish("rig/data", content, qos=1)

    def put(self, numbers):
        for k in numbers:
            self.publish(k, self.raw(k))

    def put_late(self, numbers):
        """Of a channel, values come in order; those of one channel may come behind those of another."""
        for name in UNITS:
            for k in numbers:
                self.publish(k, {name: self.raw(k)[name]})

    def put_bad(self, k):
        content = f'{{"at": {1e3 * self.stamp(k)}, "values": [{{"u": {WRONG}'
        self.client.publish("rig/data", content, qos=1)
        self.put([k])

    def put_wrong_type(self, k):
        self.publish(k, self.raw(k) | {"u": f"{WRONG}"})

    def put_no_value(self, k):
        self.publish(k, self.raw(k) | {"u": None})

    def begin_anew(self):
        self.set_back()

    def cut(self):
        self.broker.terminate()
        self.broker.wait(PATIENCE)

    def restore(self):
        self.broker = self.fixture("start_mosquitto")(self.port)
        self.catch_up()

    def close(self):
        self.client.disconnect()
        self.client.loop_stop()


class GrowingFileRig(StampedRig):
    """A logger that adds rows to its text file."""

    kind = "file"
    lacks: ClassVar = {
        "late": "rows stand in the order in which they were written: a step back is a clock that was set"
    }
    counts: ClassVar = {
        "gap": {"lost"},
        "repeat": {"duplicated"},
        "no value": {"no_value"},
        "bad": {"undecodable"},
        "wrong type": {"bad_status"},
        "anew": {"counter_jumps"},
        "cut": {"bus_errors", "reconnects"},
        "nowhere": {"bus_errors"},
    }

    def map_text(self):
        stream = {
            "sample_time": self.sample_time,
            "time": {"column": "at", "form": "epoch s"},
            "channels": self.scaled("column", {"u": "u raw", "y": "y raw"}),
        }
        return yaml.safe_dump({"delimiter": ";", "streams": {"machine": stream}})

    def begin(self):
        self.file = self.folder / "log.csv"
        self.restore()
        return {"channel": f"file:{self.file}"}

    def nowhere(self):
        return {"channel": f"file:{self.folder}/no-such-folder/log.csv"}

    def add(self, text):
        if self.file.exists():
            with self.file.open("a") as file:
                file.write(text)

    def row(self, k, **others):
        values = self.raw(k) | others
        return f"{self.stamp(k):.6f};{values['y']};a word;{values['u']}\n"

    def put(self, numbers):
        self.add("".join(map(self.row, numbers)))

    def put_bad(self, k):
        self.add(f"{self.stamp(k):.6f};{WRONG}\n")  # too few cells
        self.put([k])

    def put_wrong_type(self, k):
        self.add(self.row(k, u=f"{WRONG} or so"))

    def put_no_value(self, k):
        self.add(self.row(k, u=""))

    def begin_anew(self):
        self.set_back()

    def cut(self):
        self.file.unlink()

    def restore(self):
        self.file.write_text("# of a rig\nat;y raw;note;u raw\n")
        self.catch_up()


RIGS = (CanRig, PagedModbusRig, PolledModbusRig, OpcuaRig, SparkplugRig, MqttRig, GrowingFileRig)
"""A device of every kind of source, some of two."""
