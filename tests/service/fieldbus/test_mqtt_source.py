"""JSON over MQTT, with a real broker: objects with many channels, a value a topic, stamps of several forms, what is no number."""

import json
import time

import numpy as np
import pytest
import yaml

pytest.importorskip(
    "paho.mqtt.client", reason="the extra 'mqtt' is not installed: it was not tried"
)

from residuum.identification.errors import BadInput
from residuum.service.broker import broker_address
from residuum.service.fieldbus import SOURCES
from residuum.service.fieldbus.mqtt.topic_map import TopicMap, read_topic_map, value_at
from residuum.service.fieldbus.settings import SourceSettings

T0, STEP = 1_790_000_000, 0.1


class Bench:
    """A broker, a device that publishes, and the source that reads it."""

    def __init__(self, url, folder, streams):
        file = folder / "topics.yaml"
        file.write_text(yaml.safe_dump({"streams": streams}))
        self.blocks = []
        address = broker_address(url)
        self.device = address.client()
        self.device.connect(address.host, address.port)
        self.device.loop_start()
        settings = SourceSettings(kind="mqtt", channel=url, map=str(file))
        self.source = SOURCES["mqtt"](settings, lambda b: self.blocks.append(b) or True)

    def start(self):
        self.source.start()
        assert self.wait(self.source._connected.is_set)

    def stop(self):
        self.source.stop()
        self.source.join()
        self.device.disconnect()
        self.device.loop_stop()

    def publish(self, topic, content, **options):
        text = content if isinstance(content, str) else json.dumps(content)
        self.device.publish(topic, text, qos=1, **options).wait_for_publish(60)

    def wait(self, condition):
        end = time.monotonic() + 60
        while not (holds := condition()) and time.monotonic() < end:
            time.sleep(0.01)
        return holds

    def counted(self):
        counters = self.source.health.snapshot()["counters"]
        return {name: times for name, times in counters.items() if times}

    def values(self, channel):
        return [v for b in self.blocks for v in b.channels.get(channel, np.empty(0)).tolist()]


@pytest.fixture
def make_bench(start_mosquitto, free_port, tmp_path):
    made = []

    def make(streams):
        port = free_port()
        start_mosquitto(port)
        made.append(Bench(f"mqtt://127.0.0.1:{port}", tmp_path, streams))
        return made[-1]

    yield make
    for bench in made:
        bench.stop()


def stream(form="s", **channels):
    return {
        "sample_time": STEP,
        "topic": "press/data",
        "time": {"path": "/time", "form": form},
        "channels": channels,
    }


SPEED = {"path": "/motor/speed", "unit": "rpm"}
FORCE = {"path": "force", "unit": "N", "scale": 1000}


def message(k, **others):
    return {"time": T0 + STEP * k, "motor": {"speed": k, "name": "M1"}, "force": 0.5} | others


@pytest.mark.parametrize(
    ("form", "stamp"),
    [
        ("s", lambda k: T0 + STEP * k),
        ("ms", lambda k: 1000 * T0 + 100 * k + 3),
        ("us", lambda k: 1_000_000 * T0 + 100_000 * k),
        ("ns", lambda k: 1_000_000_000 * T0 + 100_000_000 * k),
        ("iso", lambda k: f"2026-11-28T10:20:30.{k}04Z"),
        ("iso", lambda k: f"2026-11-28T{11 - k % 2}:20:30.{k}+0{1 - k % 2}:00"),
    ],
)
def test_an_object_has_many_channels_and_its_stamp(make_bench, form, stamp):
    bench = make_bench({"signals": stream(form, speed=SPEED, force=FORCE)})
    bench.start()
    for k in (0, 1, 2, 4):
        bench.publish("press/data", message(k, time=stamp(k)))
    assert bench.wait(lambda: len(bench.values("speed")) == 4)
    assert bench.values("speed") == [0, 1, 2, 4] and bench.values("force") == [500] * 4
    number = np.concatenate([b.number for b in bench.blocks])
    assert (number - number[0]).tolist() == [0, 1, 2, 4]
    assert bench.counted() == {"lost": 1}


def test_what_is_no_number_is_missing_and_counted(make_bench):
    on = {"path": "/on", "boolean": True}
    bench = make_bench({"signals": stream(speed=SPEED, on=on)})
    bench.start()
    wrong = ["12", True, {"a": 1}, [1], 10**400]
    none = [None, float("nan"), float("inf")]
    for k, value in enumerate([*wrong, *none, 7.5]):
        bench.publish("press/data", message(k, motor={"speed": value}, on=k % 2 == 0))
    for k, value in enumerate([1, "true"], start=9):
        bench.publish("press/data", message(k, on=value))
    assert bench.wait(lambda: len(bench.values("speed")) == 11)
    assert np.isnan(bench.values("speed")[:8]).all() and bench.values("speed")[8:] == [7.5, 9, 10]
    assert bench.values("on")[:9] == [1, 0] * 4 + [1] and np.isnan(bench.values("on")[9:]).all()
    assert bench.counted() == {"bad_status": len(wrong) + 2, "no_value": len(none)}


@pytest.mark.parametrize(
    ("content", "counter"),
    [
        ('{"time": 1, "motor": {"speed": 2}', "undecodable"),
        ('{"time": 1, "motor": {"speed": 2, "speed": 3}}', "undecodable"),
        ("[" * 100_000, "undecodable"),
        ('"' + "x" * (1 << 20) + '"', "undecodable"),
        ('{"motor": {"speed": 2}}', "unstamped"),
        ('{"time": "10:00", "motor": {"speed": 2}}', "unstamped"),
        ('{"time": NaN, "motor": {"speed": 2}}', "unstamped"),
        ('{"time": true, "motor": {"speed": 2}}', "unstamped"),
        ("7", "unstamped"),
        (b"\xff\xfe\x00", "undecodable"),
    ],
)
def test_a_message_that_cannot_be_read_is_counted_and_costs_no_other(make_bench, content, counter):
    bench = make_bench({"signals": stream(speed=SPEED)})
    bench.start()
    bench.publish("press/data", message(0))
    bench.device.publish("press/data", content, qos=1).wait_for_publish(60)
    bench.publish("press/data", message(1))
    assert bench.wait(lambda: bench.values("speed") == [0, 1])
    assert bench.counted() == {counter: 1}
    assert "\n" not in bench.source.health.snapshot()["last_trouble"]


def test_a_value_a_topic_is_placed_by_its_arrival_and_that_is_said(make_bench):
    channels = {name: {"topic": f"press/{name}", "unit": "V"} for name in ("u", "y")}
    bench = make_bench({"signals": {"sample_time": 0.05, "time": "arrival", "channels": channels}})
    assert "at which they arrive" in bench.source.health.snapshot()["remarks"][0]
    bench.start()
    k = 0
    while len(bench.values("u")) < 5 and k < 1000:
        bench.publish("press/u", str(k))
        bench.publish("press/y", str(-k))
        k += 1
        time.sleep(0.05)
    values = [v for v in bench.values("u") if not np.isnan(v)]
    assert values == sorted(values) and set(values) <= set(range(k))


def test_a_retained_message_states_what_was_and_is_no_sample(make_bench):
    bench = make_bench({"signals": stream(speed=SPEED)})
    bench.publish("press/data", message(-1000), retain=True)
    bench.start()
    bench.publish("press/data", message(0))
    assert bench.wait(lambda: bench.values("speed"))
    assert bench.values("speed") == [0] and bench.counted() == {}


def test_a_wildcard_stands_for_one_topic_and_a_second_one_is_not_mixed_in(make_bench):
    bench = make_bench({"signals": stream(speed={**SPEED, "topic": "plant/+/data"})})
    bench.start()
    for k in range(3):
        bench.publish("plant/press-1/data", message(k))
        bench.publish("plant/press-2/data", message(k, motor={"speed": 99}))
    assert bench.wait(lambda: bench.counted().get("undecodable") == 3)
    assert bench.wait(lambda: len(bench.values("speed")) == 3)
    assert bench.values("speed") == [0, 1, 2]
    assert "plant/press-2/data" in bench.source.health.snapshot()["last_trouble"]


def test_a_path_that_no_message_has_is_said(make_bench):
    bench = make_bench({"signals": stream(speed={**SPEED, "path": "/motor/sped"})})
    bench.start()
    bench.publish("press/data", message(0))
    assert bench.wait(lambda: bench.source.health.snapshot()["remarks"])
    assert bench.source.health.snapshot()["remarks"] == [
        "channel 'speed': no message of 'press/data' has '/motor/sped'"
    ]


def test_a_map_that_cannot_be_is_refused_in_one_line(tmp_path):
    file = tmp_path / "topics.yaml"
    for change in (
        {"topic": "press/#/data"},
        {"topic": "press+/data"},
        {"topic": ""},
        {"time": {"path": "/t", "form": "days"}},
        {"time": "now"},
    ):
        file.write_text(yaml.safe_dump({"streams": {"s": stream(speed=SPEED) | change}}))
        with pytest.raises(BadInput) as refused:
            read_topic_map(file)
        assert "streams.s" in str(refused.value) and "\n" not in str(refused.value)
    with pytest.raises(BadInput, match="mqtt://"):
        TopicMap(streams={"s": stream(speed=SPEED)}).entered("http://broker")


def test_pointers():
    content = {"a/b": {"m~n": [10, {"": 5}]}}
    assert value_at(content, "/a~1b/m~0n/0") == 10 and value_at(content, "a~1b/m~0n/1/") == 5
    assert value_at(3, "") == 3
    for path in ("/a~1b/m~0n/2", "/a~1b/m~0n/-", "/x", "/a~1b/m~0n/0/0"):
        assert not isinstance(value_at(content, path), int | dict | list)
