import importlib.util
import itertools
import random
import socket
import time
from pathlib import Path

import numpy as np
import pytest

from residuum.service.fieldbus.modbus.modbus_source import ModbusSource
from residuum.service.fieldbus.modbus.register_map import RegisterMap, read_register_map
from residuum.service.fieldbus.sequence import BREAK
from residuum.service.fieldbus.settings import MAPS
from residuum.service.fieldbus.source import FaultsUnavailable

_spec = importlib.util.spec_from_file_location(
    "faulty_modbus", Path(__file__).with_name("faulty_modbus.py")
)
faulty_modbus = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(faulty_modbus)
FaultyModbus, KINDS, truth = faulty_modbus.FaultyModbus, faulty_modbus.KINDS, faulty_modbus.truth

MAP = read_register_map(MAPS / "process_plant.yaml")


class Bench:
    """A Modbus source reading from a server that can be made to answer wrongly."""

    def __init__(self, faults=()):
        self.server = FaultyModbus(iter(faults))
        self.blocks = []
        # without faults nothing may be counted, however busy this machine is
        self.source = ModbusSource(
            "127.0.0.1",
            self.server.port,
            MAP,
            lambda block: self.blocks.append(block) or True,
            timeout=0.1 if faults else 5.0,
        )

    def wait(self, condition, seconds=120.0):
        end = time.monotonic() + seconds
        while not condition() and time.monotonic() < end:
            time.sleep(0.01)
        assert condition()

    def counted(self):
        return {
            name: times
            for name, times in self.source.health.snapshot()["counters"].items()
            if times
        }

    def read(self):
        return (
            np.concatenate([block.number for block in self.blocks])
            if self.blocks
            else np.empty(0, int)
        )

    def assert_all_values_are_true(self):
        for block in self.blocks:
            for number, u, y in zip(
                block.number % BREAK, block.channels["u"], block.channels["y"], strict=True
            ):
                expected = truth(int(number))
                assert (u, y) == (expected["u"], expected["y"]), f"sample {number} is wrong"

    def stop(self):
        self.source.stop()
        self.source.join()
        self.server.stop()


@pytest.fixture
def make_bench():
    benches = []

    def make(faults=()):
        benches.append(Bench(faults))
        return benches[-1]

    yield make
    for bench in benches:
        bench.stop()


def test_pages_are_read_in_turn_from_the_oldest_one(make_bench):
    bench = make_bench()
    bench.server.publish(300)
    bench.source.start()
    bench.wait(lambda: len(bench.read()) == 300)
    bench.server.publish(5)
    bench.wait(lambda: len(bench.read()) == 305)
    assert np.array_equal(bench.read(), np.arange(305))
    bench.assert_all_values_are_true()
    assert bench.counted() == {}


@pytest.mark.parametrize("kind", [*KINDS, *faulty_modbus.NO_REPLY_AT_ALL])
def test_one_wrong_reply_of_each_kind_costs_no_sample_and_is_counted(make_bench, kind):
    bench = make_bench(itertools.chain([None] * 3, [kind], itertools.repeat(None)))
    bench.server.publish(60)
    bench.source.start()
    bench.wait(lambda: len(bench.read()) == 60)
    assert np.array_equal(bench.read(), np.arange(60))
    bench.assert_all_values_are_true()
    # what was in the registers before: a page that is not the one asked for, or no page at all
    if kind != "old content":
        assert sum(bench.counted().values()) >= 1
    assert bench.server.done == 1
    assert (kind in faulty_modbus.NO_REPLY_AT_ALL) <= bench.counted().get("undecodable", 0)


def test_many_random_wrong_replies_let_no_wrong_value_through(make_bench):
    rng = random.Random(5)
    bench = make_bench(
        rng.choice(KINDS) if rng.random() < 0.25 else None for _ in itertools.count()
    )
    bench.source.start()
    end = time.monotonic() + 120
    while bench.server.done < 40 and time.monotonic() < end:
        bench.server.publish(3)
        time.sleep(0.02)
    bench.server.faults = iter(())
    bench.server.publish(1)
    bench.wait(lambda: len(bench.read()) and bench.read()[-1] == bench.server.complete - 1)
    bench.assert_all_values_are_true()
    number, lost = bench.read(), bench.counted().get("lost", 0)
    assert len(number) + lost == bench.server.complete and np.all(np.diff(number) >= 1)
    assert bench.server.done >= 40


def test_a_device_that_begins_anew_and_a_ring_that_went_round_are_counted(make_bench):
    bench = make_bench()
    bench.server.publish(20)
    bench.source.start()
    bench.wait(lambda: len(bench.read()) == 20)
    bench.server.complete = 0
    bench.server.publish(10)
    bench.wait(lambda: len(bench.read()) == 30)
    assert bench.read()[20] == BREAK
    bench.server.publish(1000)
    bench.wait(lambda: bench.read()[-1] == BREAK + 1009)
    assert bench.counted() == {"counter_jumps": 1, "lost": 1000 - 510}
    bench.assert_all_values_are_true()


def test_a_device_that_is_not_there_is_counted_and_found_when_it_comes(make_bench):
    bench = make_bench()
    port = bench.server.port
    bench.server.stop()
    bench.source.start()
    bench.wait(lambda: bench.source.health["bus_errors"] >= 1)
    assert bench.source.health.snapshot()["quality"] == "never-seen"
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", port)) != 0
    with pytest.raises(FaultsUnavailable, match="cannot switch"):
        bench.source.switch_fault("sensor-offset", 1.0)


def test_plain_registers_are_polled_on_the_readers_clock(make_bench):
    bench = make_bench()
    bench.server.memory[40:42] = (7, 0xFFFE)
    channels = {
        "level": {"register": 0, "scale": 0.1, "unit": "m"},
        "flow": {"register": 1, "type": "int16", "unit": "l/min"},
    }
    plain = RegisterMap.model_validate(
        {"streams": {"tank": {"sample_time": 0.05, "poll": {"address": 40}, "channels": channels}}}
    )
    blocks = []
    source = ModbusSource(
        "127.0.0.1", bench.server.port, plain, lambda block: blocks.append(block) or True
    )
    source.start()
    bench.wait(lambda: len(blocks) >= 10)
    source.stop()
    source.join()
    assert (
        blocks[0].channels["level"][0] == pytest.approx(0.7)
        and blocks[0].channels["flow"][0] == -2.0
    )
    numbers = np.concatenate([block.number for block in blocks])
    assert numbers[0] == 0 and np.all(np.diff(numbers) >= 1)
    assert source.health["lost"] == numbers[-1] + 1 - len(numbers)


def test_pages_side_by_side_are_read_many_in_one_request(make_bench):
    asked = []
    bench = make_bench()
    bench.server.faults = iter(lambda: asked.append(1), 0)
    bench.server.publish(400)
    bench.source.start()
    bench.wait(lambda: len(bench.read()) == 400)
    assert np.array_equal(bench.read(), np.arange(400))
    bench.assert_all_values_are_true()
    assert len(asked) < 60


def test_pages_that_were_written_over_while_they_were_read_are_lost_and_end_no_connection(
    make_bench,
):
    bench = make_bench()

    def device_runs_ahead():
        yield None  # where the newest page is
        bench.server.publish(600)
        yield None  # pages 0 … 16, as they were
        yield from itertools.repeat(None)

    bench.server.faults = device_runs_ahead()
    bench.server.publish(20)
    bench.source.start()
    bench.wait(lambda: len(bench.read()) and bench.read()[-1] == 619)
    assert len(bench.read()) + bench.counted()["lost"] == 620
    assert set(bench.counted()) == {"lost"}
    bench.assert_all_values_are_true()
