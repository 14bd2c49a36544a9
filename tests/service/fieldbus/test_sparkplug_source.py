"""Sparkplug B over a real broker: a node is read, asked to be born again, browsed; our findings are such a node."""

import json
import queue
import time
from contextlib import suppress
from datetime import UTC, datetime

import numpy as np
import pytest
import yaml

pytest.importorskip(
    "google.protobuf", reason="the extra 'sparkplug' is not installed: Sparkplug was not tried"
)
import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion

from benchmarks import sparkplug as campaign
from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.broker import broker_address
from residuum.service.cli import BAD_INPUT, DONE, run
from residuum.service.fieldbus import SOURCES
from residuum.service.fieldbus.can.frame_layout import BadBusDescription
from residuum.service.fieldbus.settings import SourceSettings
from residuum.service.fieldbus.sparkplug.metric_map import MetricMap, read_metric_map
from residuum.service.fieldbus.sparkplug.sparkplug_payload import (
    BOOLEAN,
    Metric,
    Payload,
    pack,
    unpack,
)
from residuum.service.fieldbus.sparkplug.sparkplug_source import REBIRTH, SparkplugSource
from residuum.service.finding_metrics import EdgeNode, FindingMetrics
from residuum.service.settings import BadSettings, load_settings
from residuum.service.storage import DiskStore

STEP = 0.02


@pytest.fixture
def broker(start_mosquitto, free_port):
    port = free_port()
    start_mosquitto(port)
    return f"mqtt://127.0.0.1:{port}"


@pytest.fixture
def node(broker):
    made = EdgeNode(broker_address(broker), "Plant/Press")
    made.start()
    yield made
    made.stop()


def wait(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it never came"
        time.sleep(0.02)


class Host:
    """A host application: keeps what a node publishes, and can ask it to be born again."""

    def __init__(self, broker, node):
        self.group, self.name = node.split("/")
        address, ready = broker_address(broker), queue.Queue()
        self.heard = []
        self.client = mqtt.Client(CallbackAPIVersion.VERSION2)
        self.client.on_message = lambda _c, _d, m: self.heard.append(
            (m.topic.split("/", 2)[2], unpack(m.payload))
        )
        self.client.on_subscribe = lambda *_: ready.put(True)
        self.client.connect(address.host, address.port)
        self.client.subscribe(f"spBv1.0/{self.group}/+/{self.name}/#", 1)
        self.client.loop_start()
        assert ready.get(timeout=60)

    def ask(self):
        self.client.publish(
            f"spBv1.0/{self.group}/NCMD/{self.name}",
            pack(Payload([Metric(REBIRTH, True, BOOLEAN)], 1)),
        )

    def of(self, kind):
        return [payload for topic, payload in self.heard if topic.startswith(kind + "/")]

    def close(self):
        self.client.disconnect()
        self.client.loop_stop()


@pytest.fixture
def host(broker):
    opened = []

    def open_host(node):
        opened.append(Host(broker, node))
        return opened[-1]

    yield open_host
    for each in opened:
        each.close()


def metric_map(reports="samples", **channels):
    stream = {"device": "Drive", "sample_time": STEP, "reports": reports}
    return {
        "node": "Plant/Press",
        "streams": {"s": stream | {"channels": {c: {"metric": m} for c, m in channels.items()}}},
    }


def live(node, seconds, write):
    """Call `write(sample number, its time)` as the samples fall due."""
    end, last = time.time() + seconds, int(time.time() / STEP)
    while time.time() < end:
        now = int(time.time() / STEP)
        for i in range(last + 1, now + 1):
            write(i, i * STEP)
        last = now
        time.sleep(STEP / 4)


def test_samples_of_a_node_come_in_their_places(broker, node):
    blocks = []
    node.write("Drive", {"Motor/u": 0.0, "Motor/y": 0.0}, time.time())
    metrics = MetricMap.model_validate(metric_map(u="Motor/u", y="Motor/y"))
    source = SparkplugSource(broker_address(broker), metrics, lambda b: blocks.append(b) or True)
    source.start()
    live(
        node, 3.0, lambda i, at: node.write("Drive", {"Motor/u": float(i), "Motor/y": 2.0 * i}, at)
    )
    wait(lambda: sum(b.n for b in blocks) > 50)
    source.stop()
    source.join()
    number = np.concatenate([b.number for b in blocks])
    u, y = (np.concatenate([b.channels[name] for b in blocks]) for name in ("u", "y"))
    assert len(set(number - u)) == 1 and np.array_equal(y, 2 * u)
    assert source.health["rebirths_asked"] >= 1 and source.health["sequence_gaps"] == 0


def test_values_reported_by_change_hold_until_the_next(broker, node):
    blocks = []
    node.write("Drive", {"u": 0.0, "y": 5.0}, time.time())
    metrics = MetricMap.model_validate(metric_map(reports="changes", u="u", y="y"))
    source = SparkplugSource(broker_address(broker), metrics, lambda b: blocks.append(b) or True)
    source.start()
    live(node, 2.0, lambda i, at: node.write("Drive", {"u": float(i)}, at) if i % 5 == 0 else None)
    wait(lambda: sum(b.n for b in blocks) > 40)
    source.stop()
    source.join()
    u, y = (np.concatenate([b.channels[name] for b in blocks]) for name in ("u", "y"))
    assert set(y) == {5.0} and set(u % 5) == {0.0}
    assert all(len(set(run)) == 1 for run in np.split(u, np.flatnonzero(np.diff(u)) + 1)) and set(
        np.diff(np.unique(u))
    ) == {5.0}


def test_a_metric_that_the_birth_lacks_is_told_with_the_nearest(broker, node):
    node.write("Drive", {"Motor/Speed": 1.0}, time.time())
    source = SparkplugSource(
        broker_address(broker), MetricMap.model_validate(metric_map(u="Motor/Sped")), lambda b: True
    )
    source.start()
    wait(lambda: "nearest are Motor/Speed" in source.health.snapshot()["last_trouble"])
    source.stop()
    source.join()


def test_an_alias_that_no_birth_gave_is_a_gap(broker, node):
    node.write("Drive", {"u": 1.0}, time.time())
    source = SparkplugSource(
        broker_address(broker), MetricMap.model_validate(metric_map(u="u")), lambda b: True
    )
    source.start()
    wait(lambda: source.health["rebirths_asked"] >= 1 and source._known)
    node._aliases["Drive", "u"] = (
        77  # its births have the old one: this one was given by a birth that nobody heard
    )
    node.write("Drive", {"u": 2.0}, time.time())
    wait(lambda: source.health["sequence_gaps"] == 1 and source.health["rebirths_asked"] >= 2)
    source.stop()
    source.join()


def test_a_flood_takes_no_more_than_its_share_and_no_more_memory():
    taken = []
    source = SparkplugSource(
        broker_address("mqtt://127.0.0.1:1"),
        MetricMap.model_validate(metric_map(u="u")),
        lambda b: True,
    )
    source._take = lambda *message: taken.append(message)
    for _ in range(3000):
        source._wait("spBv1.0/Plant/NDATA/Press", b"")
    source._take_what_arrived()
    assert len(taken) == 1000 and source.health["overflow"] == 0
    for _ in range(10_000):
        source._wait("spBv1.0/Plant/NDATA/Press", b"")
    assert source._arrived.qsize() == 10_000 and source.health["overflow"] == 2000
    source._take_what_arrived()
    assert source._arrived.empty() and source.health["overflow"] == 12_000, (
        "what has a hole behind it is not believed"
    )


def test_a_node_is_born_again_after_a_flood(broker, node, monkeypatch):
    monkeypatch.setattr("residuum.service.fieldbus.broker_source.MOST_WAITING", 5)
    blocks = []
    node.write("Drive", {"u": 0.0}, time.time())
    source = SparkplugSource(
        broker_address(broker),
        MetricMap.model_validate(metric_map(u="u")),
        lambda b: blocks.append(b) or True,
    )
    source.start()
    wait(lambda: source._known)
    asked = source.health["rebirths_asked"]
    begin = time.time()
    for i in range(2000):
        node.write("Drive", {"u": float(i)}, begin + i * 1e-3)
    wait(
        lambda: (
            source.health["overflow"]
            and source.health["rebirths_asked"] > asked
            and source._session.in_step
        )
    )
    before = sum(b.n for b in blocks)

    def flows():  # where the machine is busy, live samples flood the five places again: the node goes on until it is believed
        live(node, 1.0, lambda i, at: node.write("Drive", {"u": float(i)}, at))
        return sum(b.n for b in blocks) > before

    wait(flows, 180.0)
    source.stop()
    source.join()


def test_a_short_campaign_of_losses_repetitions_disorder_and_births(broker):
    found = campaign.campaign(broker, messages=700, seed=5)
    assert found["messages"] >= 700 and found["good samples"] > 100
    assert not campaign.failed(found), found


def test_browsing_writes_the_map(broker, node, tmp_path, capsys, monkeypatch):
    node.write("Drive", {"Motor/Speed": 1.0, "Motor/On": True, "State": "runs"}, time.time())
    out = tmp_path / "metrics.yaml"
    assert (
        run(["sparkplug", "browse", broker, "Plant/Press", "--out", str(out), "--every", "0.02"])
        == DONE
    )
    stream = read_metric_map(out).streams["Drive"]
    assert {name: each.metric for name, each in stream.channels.items()} == {
        "Motor.Speed": "Motor/Speed",
        "Motor.On": "Motor/On",
    }
    assert stream.device == "Drive" and stream.sample_time == 0.02
    capsys.readouterr()
    settings = tmp_path / "residuum.yaml"
    assert (
        run(["watch", "init", "--sparkplug", broker, "--map", str(out), "--out", str(settings)])
        == DONE
    )
    source = yaml.safe_load(settings.read_text())["machines"][0]["sources"][0]
    assert source == {"kind": "sparkplug", "channel": broker, "map": str(out)}
    capsys.readouterr()
    monkeypatch.setenv("RESIDUUM_SETTINGS", str(settings))
    run(["doctor", "--data", str(tmp_path / "var"), "--json"])
    checks = {check["name"]: check for check in json.loads(capsys.readouterr().out)["checks"]}
    assert (
        checks["sparkplug bus"]["ok"]
        and "1 streams of Plant/Press" in checks["sparkplug bus"]["says"]
    )
    for name in ("Plant", "Plant/+", "#/Press", "Plant/Press/Drive"):
        capsys.readouterr()
        assert (
            run(["sparkplug", "browse", broker, name, "--out", str(tmp_path / "other.yaml")])
            == BAD_INPUT
        )
        assert "must be GROUP/NODE" in capsys.readouterr().err


def test_metrics_whose_channels_would_be_the_same_are_numbered(broker, node, tmp_path):
    node.write("Drive", {"a/b c": 1.0, "a.b c": 2.0, "a/b-c": 3.0}, time.time())
    out = tmp_path / "metrics.yaml"
    assert run(["sparkplug", "browse", broker, "Plant/Press", "--out", str(out)]) == DONE
    channels = {
        name: each.metric for name, each in read_metric_map(out).streams["Drive"].channels.items()
    }
    assert channels == {"a.b-c": "a/b c", "a.b-c-2": "a.b c", "a.b-c-3": "a/b-c"}


def test_findings_are_metrics_of_a_node_that_is_born_again_when_asked(broker, host):
    at = datetime(2026, 11, 25, 1, 2, 3, tzinfo=UTC)
    listening = host("Plant/Residuum")
    out = FindingMetrics(broker_address(broker), "Plant/Residuum")
    out.start()
    wait(lambda: listening.of("NBIRTH"))
    finding = {
        "asset": "press-1",
        "at": at,
        "verdict": "faulty",
        "class": "wear",
        "reason": "why",
        "indicators": {"glr": 14.5},
    }
    out.tell("finding", finding)
    out.tell("finding", finding | {"verdict": "healthy"})
    out.tell("alarm", {"asset": "press-1", "state": "active"})
    out.tell("model", {})
    wait(lambda: len(listening.of("DBIRTH")) == 2 and listening.of("DDATA"))
    first, with_alarm = ({m.name: m for m in birth.metrics} for birth in listening.of("DBIRTH"))
    assert (first["verdict"].value, first["indicator/glr"].value) == ("faulty", 14.5)
    assert (
        first["verdict"].stamp == round(at.timestamp() * 1e3)
        and with_alarm["alarm"].value == "active"
    )
    names = {m.alias: m.name for m in first.values()}
    assert {names[m.alias]: m.value for m in listening.of("DDATA")[0].metrics}[
        "verdict"
    ] == "healthy"
    assert [payload.seq for _, payload in listening.heard] == [0, 1, 2, 3]
    listening.ask()
    wait(lambda: len(listening.of("DBIRTH")) == 3)
    assert [payload.seq for _, payload in listening.heard][-2:] == [0, 1]
    out.stop()
    wait(lambda: listening.of("NDEATH"))
    number = {birth.metrics[0].value for birth in listening.of("NBIRTH")}
    assert {death.metrics[0].value for death in listening.of("NDEATH")} == number


def test_a_service_publishes_what_it_stored(broker, host, run_service):
    listening = host("Plant/Residuum")
    service = run_service(mqtt=broker, sparkplug="Plant/Residuum")
    record = Record({"y": [0.0, 1.0]}, {"y": "V"}, 1.0)
    service.services.store.add_window("press", record, Finding("bearing", "faulty", reason="worn"))
    wait(lambda: any(topic.startswith("DBIRTH/Residuum/press") for topic, _ in listening.heard))
    birth = {m.name: m.value for m in listening.of("DBIRTH")[0].metrics}
    assert (birth["verdict"], birth["reason"]) == ("faulty", "worn")


def test_a_service_publishes_what_it_stored_and_what_the_store_had_at_its_start(
    broker, host, run_service, free_port
):
    asyncua = pytest.importorskip(
        "asyncua.sync", reason="the extra 'opcua' is not installed: its nodes were not tried"
    )
    opcua = f"opc.tcp://127.0.0.1:{free_port()}/"
    listening = host("Plant/Residuum")
    service = run_service(
        mqtt=broker, sparkplug="Plant/Residuum", opcua_server=opcua, opcua_anonymous=True
    )
    record = Record({"y": [0.0, 1.0]}, {"y": "V"}, 1.0)

    def said():
        births = [
            payload
            for topic, payload in listening.heard
            if topic.startswith("DBIRTH/Residuum/press")
        ]
        return {m.name: m.value for m in births[-1].metrics} if births else {}

    def served(name):
        with asyncua.Client(opcua) as client, suppress(Exception):
            return client.get_node(f"ns=2;s=press.{name}").read_value()

    store = service.services.store
    store.add_window("press", record, Finding("bearing", "faulty", reason="worn"))
    wait(lambda: "alarm" in said())
    assert (said()["verdict"], said()["reason"], said()["alarm"]) == (
        "faulty",
        "worn",
        "unacknowledged",
    )
    wait(lambda: served("verdict") == "faulty" and served("alarm") == "unacknowledged")
    service.stop()
    settings = service.services.settings
    theirs = DiskStore(settings.data, settings.database_url)
    theirs.add_window("press", record, Finding("bearing", "faulty", reason="while nobody looked"))
    theirs.close()
    listening.heard.clear()
    service.start()
    wait(lambda: said().get("reason") == "while nobody looked" and "alarm" in said())
    wait(lambda: served("reason") == "while nobody looked" and served("alarm") == "unacknowledged")


def test_settings_of_a_source_and_of_a_node(tmp_path):
    file = tmp_path / "metrics.yaml"
    file.write_text(
        "{node: G/N, streams: {s: {sample_time: 0.1, channels: {u: {metric: a, unit: V}}}}}"
    )
    source = SOURCES["sparkplug"](
        SourceSettings(kind="sparkplug", channel="mqtt://127.0.0.1:1", map=str(file)),
        lambda b: True,
    )
    assert [(s.name, dict(s.units)) for s in source.streams] == [("s", {"u": "V"})]
    with pytest.raises(ValueError, match="must be mqtt://"):
        SourceSettings(kind="sparkplug", channel="broker", map=str(file))
    with pytest.raises(BadSettings, match="set mqtt, too"):
        load_settings(sparkplug="G/N")
    with pytest.raises(BadSettings, match="must be GROUP/NODE"):
        load_settings(sparkplug="G", mqtt="mqtt://broker")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{node: G, streams: {s: {sample_time: 1, channels: {u: {metric: a}}}}}", "node"),
        ("{node: G/N, streams: {}}", "streams"),
        (
            "{node: G/N, streams: {s: {sample_time: 1, reports: often, channels: {u: {metric: a}}}}}",
            r"streams\.s\.reports",
        ),
        ("{node: [", "not YAML"),
        (
            "{node: G/N, streams: {s: {sample_time: 1, channels: {u: {metric: a}, u: {metric: b}}}}}",
            "'u' is named twice",
        ),
    ],
)
def test_a_bad_map_is_refused(tmp_path, text, says):
    file = tmp_path / "metrics.yaml"
    file.write_text(text)
    with pytest.raises(BadBusDescription, match=says):
        read_metric_map(file)
