import time
import uuid

import can
import numpy as np
import pytest

from residuum.identification.errors import BadInput
from residuum.service.fieldbus import SOURCES
from residuum.service.fieldbus.can.can_bus import open_bus
from residuum.service.fieldbus.can.frame_layout import read_dbc
from residuum.service.fieldbus.sequence import BREAK
from residuum.service.fieldbus.settings import MAPS, SourceSettings

DBC = read_dbc(MAPS / "gate_actuator.dbc")
DRIVE = DBC["drive"]


def truth(number):
    """What sample `number` holds, on the grid of the message's scales."""
    return {
        "speed": 0.02 * (number % 20_000),
        "current": 0.002 * (number % 977),
        "voltage": np.full(len(number), 24.0),
        "phase": number % 3,
    }


class Bench:
    """A CAN source on a virtual bus, and the bus to send on."""

    def __init__(self, channel=None):
        self.channel = channel or f"virtual:{uuid.uuid4()}"
        self.blocks, self.room = [], True
        settings = SourceSettings(kind="can", channel=self.channel, map="gate_actuator.dbc")
        self.source = SOURCES["can"](settings, self.take)
        # a pause of this bench is a busy machine, not a silent sender
        self.source._clock = lambda: 0.0
        self.source.start()
        self.bus = open_bus(self.channel)
        self.wait(lambda: self.source._bus is not None)

    def take(self, block):
        if self.room:
            self.blocks.append(block)
        return self.room

    def send(self, numbers):
        frames = DRIVE.encode(
            np.asarray(numbers) % (1 << DRIVE.counter_bits), truth(np.asarray(numbers))
        )
        self.bus.send_many(DRIVE.frame_id, frames)

    def wait(self, condition):
        end = time.monotonic() + 120
        while not condition() and time.monotonic() < end:
            time.sleep(0.01)
        assert condition()

    def counted(self):
        return {
            name: times
            for name, times in self.source.health.snapshot()["counters"].items()
            if times
        }

    def samples(self):
        number = np.concatenate([block.number for block in self.blocks])
        return number, {
            name: np.concatenate([block.channels[name] for block in self.blocks])
            for name in DRIVE.units
        }


@pytest.fixture
def bench():
    bench = Bench()
    yield bench
    bench.source.stop()
    bench.source.join()
    bench.bus.close()


def test_every_sample_arrives_with_its_number_and_value(bench):
    for begin in range(0, 20_000, 500):
        bench.send(range(begin, begin + 500))
    bench.wait(lambda: bench.source.health.snapshot()["samples"] == 20_000)
    number, channels = bench.samples()
    assert np.array_equal(number, np.arange(20_000))
    for name, values in truth(number).items():
        assert np.allclose(channels[name], values, atol=1e-9)
    assert bench.counted() == {}
    assert bench.source.health.snapshot()["quality"] == "good"


def test_thousands_of_drops_repetitions_and_late_frames_are_counted_exactly(bench):
    rng = np.random.default_rng(3)
    numbers = np.arange(30_000)
    dropped = rng.random(len(numbers)) < 0.1
    dropped[[0, -1]] = False
    sent = numbers[~dropped]
    late = np.arange(100, len(sent) - 100, 40)
    sent[late], sent[late + 1] = sent[late + 1], sent[late].copy()
    repeated = rng.random(len(sent)) < 0.1
    arriving = np.repeat(sent, np.where(repeated, 2, 1))
    seen, highest, reordered = set(), -1, 0
    for number in arriving.tolist():
        reordered += number < highest and number not in seen
        seen.add(number)
        highest = max(highest, number)
    for begin in range(0, len(arriving), 400):
        bench.send(arriving[begin : begin + 400])
    bench.wait(lambda: bench.source.health.snapshot()["frames"] == len(arriving))
    counted = bench.counted()
    assert counted == {
        "lost": int(dropped.sum()),
        "duplicated": int(repeated.sum()),
        "reordered": reordered,
    }
    assert sum(counted.values()) > 6000
    number, channels = bench.samples()
    assert len(np.unique(number)) == len(number) == len(sent)
    assert np.allclose(channels["speed"], truth(number)["speed"], atol=1e-9)


def test_a_restarted_sender_a_wrong_length_and_error_frames_are_counted(bench):
    bench.send(range(7000))
    bench.send(range(3))
    bench.bus.send(DRIVE.frame_id, b"123")
    bench.bus._bus.send(can.Message(arbitration_id=0, is_error_frame=True))
    bench.send(range(3, 10))
    bench.wait(
        lambda: (
            bench.source.health.snapshot()["frames"] == 7010 and sum(bench.counted().values()) >= 3
        )
    )
    assert bench.counted() == {"counter_jumps": 1, "undecodable": 1, "bus_errors": 1}


def test_bus_off_ends_the_connection_which_is_opened_again(bench):
    bench.send(range(10))
    bench.bus._bus.send(can.Message(arbitration_id=0x40, is_error_frame=True))
    bench.wait(lambda: bench.counted().get("reconnects") == 1 and bench.source._bus is not None)
    bench.send(range(10, 20))
    bench.wait(lambda: bench.source.health.snapshot()["samples"] == 20)
    assert bench.counted() == {"bus_errors": 1, "reconnects": 1}


def test_a_sink_without_room_costs_counted_samples(bench):
    bench.room = False
    bench.send(range(50))
    bench.wait(lambda: bench.counted() == {"queue_drops": 50})


def test_a_bus_that_cannot_be_opened_is_tried_again_and_again():
    source = SOURCES["can"](
        SourceSettings(kind="can", channel="socketcan:no_such_can7", map="gate_actuator.dbc"),
        lambda _: True,
    )
    source.start()
    end = time.monotonic() + 120
    while source.health["bus_errors"] < 2 and time.monotonic() < end:
        time.sleep(0.02)
    source.stop()
    source.join()
    assert source.health["bus_errors"] >= 2
    assert source.health.snapshot()["quality"] == "never-seen"


@pytest.mark.parametrize("channel", ["can0", "virtual:", ":x", "udp_multicast:239.1.1.1:port"])
def test_an_address_that_is_none_is_refused(channel):
    with pytest.raises(BadInput, match="CAN channel"):
        open_bus(channel)


def test_frames_without_a_counter_are_read_in_their_order_and_a_pause_breaks_them_off(tmp_path):
    (tmp_path / "plain.dbc").write_text(
        'VERSION ""\nBS_:\nBU_: A\nBO_ 300 plain: 2 A\n SG_ force : 0|16@1- (0.5,0) [0|0] "N" A\n'
        'BA_DEF_ BO_ "GenMsgCycleTime" INT 0 100000;\nBA_ "GenMsgCycleTime" BO_ 300 10;\n'
    )
    channel, blocks, now = f"virtual:{uuid.uuid4()}", [], [0.0]
    settings = SourceSettings(kind="can", channel=channel, map=str(tmp_path / "plain.dbc"))
    source = SOURCES["can"](settings, lambda block: blocks.append(block) or True)
    source._clock = lambda: now[0]
    source.start()
    bus = open_bus(channel)
    end = time.monotonic() + 120
    while source._bus is None and time.monotonic() < end:
        time.sleep(0.01)
    for first in (0, 20):
        bus.send_many(300, np.array([[value, 0] for value in range(first, first + 20)], np.uint8))
        while source.health.snapshot()["samples"] < first + 20 and time.monotonic() < end:
            time.sleep(0.01)
        now[0] += 60.0
    source.stop()
    source.join()
    bus.close()
    number = np.concatenate([block.number for block in blocks])
    force = np.concatenate([block.channels["force"] for block in blocks])
    assert force.tolist() == [0.5 * value for value in range(40)]
    assert number.tolist() == [*range(20), *range(BREAK + 20, BREAK + 40)]
    assert source.health["pauses"] == 1 and source.health["lost"] == 0
