"""Windows over a real broker: whatever is killed meanwhile, each is stored, once, and those of a machine in their order."""

import json
import os
import signal
import subprocess
import sys
import threading
import time

import msgpack
import numpy as np
import pytest

from residuum.diagnosis.diagnosers.robust_residual import RobustResidual
from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.service.broker import broker_address
from residuum.service.cli import run
from residuum.service.fieldbus.settings import MachineSettings, SourceSettings, WindowSettings
from residuum.service.machines.baselines import choose_method
from residuum.service.storage import DiskStore
from residuum.service.window_queue.gateway import Gateway, Spool
from residuum.service.window_queue.set_aside import SetAside
from residuum.service.window_queue.window_message import (
    PARTITIONS,
    WindowMessage,
    partition_of,
    receipt_topic,
    window_topic,
    windows_of_part,
)
from residuum.service.work.worker_pool import PlainRecord

PATIENCE = 600
ASSETS = ("press-1", "press-2", "press-3", "press-4")
PER_GATEWAY, AT_FIRST = 40, 10


def window(number):
    """A window that begins at `number` seconds, so that stored ones can be told apart and put in order."""
    rng = np.random.default_rng(number)
    return Record(
        {"acceleration": rng.normal(size=500)}, {"acceleration": "m/s²"}, 1e-3, t0=float(number)
    )


def machine(asset):
    source = SourceSettings(kind="modbus", port=1, map="process_plant.yaml")
    return MachineSettings(
        asset=asset, diagnoser="bearing", window=WindowSettings(cut="sliding"), sources=[source]
    )


def start_scorer(part, mqtt, data):
    command = [
        sys.executable,
        "-c",
        "from residuum.service.cli import main; main()",
        "scorer",
        "--part",
        part,
        "--data",
        str(data),
    ]
    environment = {**os.environ, "RESIDUUM_MQTT": mqtt, "RESIDUUM_LOG_LEVEL": "error"}
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)


def wait_for(condition, what):
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, what()
        time.sleep(0.05)


@pytest.fixture
def processes():
    """Processes that are ended in the end, whatever happened."""
    started = []
    yield started
    for process in started:
        process.kill()
        process.wait()
        process.stdout.close()


def confirm(client, message):
    """Tell gateway hall-1 of plant-7 that its window is stored."""
    receipt = {"key": message.topic.rpartition("/")[2], "refused": None}
    client.publish(receipt_topic("plant-7", "hall-1"), json.dumps(receipt), qos=1)


def test_a_killed_scorer_and_a_killed_broker_lose_nothing_and_store_nothing_twice(
    start_mosquitto, processes, free_port, tmp_path
):
    port = free_port()
    broker = start_mosquitto(port)
    mqtt, data = f"mqtt://127.0.0.1:{port}/plant-7", tmp_path / "data"
    # so that the scorers need not make it at the same time
    DiskStore(data, f"sqlite:///{data / 'residuum.db'}").close()
    spools = [Spool(tmp_path / f"spool-{k}", 2**30) for k in (1, 2)]
    gateways = [
        Gateway(f"hall-{k}", spool, broker_address(mqtt), resend_after=5.0)
        for k, spool in enumerate(spools)
    ]

    def hand_over(numbers):
        for number in numbers:
            for k, gateway in enumerate(gateways):  # two machines a gateway
                gateway.handle(machine(ASSETS[2 * k + number % 2]), window(number), "", None)

    hand_over(range(AT_FIRST))
    for gateway in gateways:
        gateway.start()
    try:
        processes += [start_scorer(f"{k}/2", mqtt, data) for k in (1, 2)]
        wait_for(
            lambda: sum(gateway.stored for gateway in gateways) >= 8,
            lambda: [g.status() for g in gateways],
        )
        # only now: however late this test looks, there is work when they are killed
        hand_over(range(AT_FIRST, PER_GATEWAY))
        # all at once, so that whichever has work is killed in the midst of it
        for process in processes:
            process.send_signal(signal.SIGKILL)
        broker.kill()
        broker.wait()
        assert any(len(spool) for spool in spools)
        start_mosquitto(port)
        processes += [start_scorer(f"{k}/2", mqtt, data) for k in (1, 2)]
        wait_for(
            lambda: not any(len(spool) for spool in spools), lambda: [g.status() for g in gateways]
        )
    finally:
        for gateway in gateways:
            gateway.stop()
    store = DiskStore(data, f"sqlite:///{data / 'residuum.db'}")
    for place, asset in enumerate(ASSETS):
        kept = list(reversed(store.windows(asset, limit=100).items))
        assert [each.t0 for each in kept] == [
            float(number) for number in range(PER_GATEWAY) if number % 2 == place % 2
        ]
        np.testing.assert_array_equal(
            store.window_record(asset, kept[-1].id)["acceleration"],
            window(int(kept[-1].t0))["acceleration"],
        )
        assert store.finding_of(kept[0].id).finding.diagnoser == "bearing"
    assert [gateway.status()["dropped"] + gateway.status()["refused"] for gateway in gateways] == [
        0,
        0,
    ]
    store.close()


def test_a_scorer_that_comes_late_gets_the_windows_of_a_machine_in_their_order(
    start_mosquitto, free_port, tmp_path
):
    """A broker forgets what nobody has subscribed to yet: what comes then must not overtake what is to be sent again."""
    mqtt = pytest.importorskip(
        "paho.mqtt.client", reason="the extra 'mqtt' is not installed: MQTT was not tried"
    )
    port = free_port()
    start_mosquitto(port)
    gateway = Gateway(
        "hall-1",
        Spool(tmp_path, 2**30),
        broker_address(f"mqtt://127.0.0.1:{port}/plant-7"),
        resend_after=1.0,
    )
    for number in range(3):
        gateway.handle(machine("press-1"), window(number), "", None)
    came, subscribed = [], threading.Event()

    def store(client, _data, message):
        came.append(WindowMessage.unpack(message.payload).window.t0)
        confirm(client, message)

    scorer = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
    scorer.on_message, scorer.on_subscribe = store, lambda *_: subscribed.set()
    gateway.start()
    try:
        wait_for(lambda: gateway.sent > 0, gateway.status)  # to nobody
        scorer.connect("127.0.0.1", port)
        scorer.loop_start()
        scorer.subscribe("plant-7/windows/#", qos=1)
        assert subscribed.wait(60)
        gateway.handle(machine("press-1"), window(3), "", None)
        wait_for(lambda: gateway.status()["waiting"] == 0, gateway.status)
    finally:
        gateway.stop()
        scorer.disconnect()
        scorer.loop_stop()
    assert list(dict.fromkeys(came)) == [0.0, 1.0, 2.0, 3.0]


def test_a_window_that_cannot_be_judged_is_set_aside_holds_up_nothing_and_can_be_sent_again(
    start_mosquitto, processes, free_port, tmp_path, monkeypatch, capsys
):
    port = free_port()
    start_mosquitto(port)
    mqtt = f"mqtt://127.0.0.1:{port}"
    monkeypatch.setenv("RESIDUUM_MQTT", mqtt)

    def command(*arguments):
        run(["set-aside", "--data", str(tmp_path / "data"), *arguments])
        return capsys.readouterr()

    gateway = Gateway("hall-1", Spool(tmp_path / "spool", 2**30), broker_address(mqtt))
    unknown = machine("press-1").model_copy(update={"diagnoser": "phlogiston"})
    gateway.handle(unknown, window(0), "", None)
    gateway.handle(machine("press-1"), window(1), "", None)
    gateway.start()
    try:
        processes.append(start_scorer("1/1", mqtt, tmp_path / "data"))
        wait_for(lambda: gateway.status()["waiting"] == 0, gateway.status)
        assert (gateway.status()["refused"], gateway.status()["stored"]) == (1, 1)
        aside = SetAside(tmp_path / "data")
        (refused,) = aside.newest()
        aside.put(
            "good",
            "hall-1",
            message_of(machine("press-1"), window(2)),
            "as if an update had mended it",
            refused.topic,
        )
        # the gateway logs there, too
        again = json.loads(command("--again", "--json").out.splitlines()[-1])
        assert again["stored"] == [
            each["name"] for each in again["messages"] if each["key"] == "good"
        ]
        (left,) = aside.newest()
        assert (
            left.key == refused.key and left.name != refused.name and "phlogiston" in left.reason
        ), "set aside anew"
        assert left.reason in command(left.name, "--to", str(tmp_path / "taken")).out
        assert WindowMessage.unpack((tmp_path / "taken").read_bytes()).diagnoser == "phlogiston"
        assert "none of this name is set aside" in command("other").err
        store = DiskStore(tmp_path / "data", f"sqlite:///{tmp_path / 'data' / 'residuum.db'}")
        assert [each.t0 for each in store.windows("press-1").items] == [2.0, 1.0]
        store.close()
    finally:
        gateway.stop()


def message_of(settings, record):
    return WindowMessage(
        settings.asset, settings.diagnoser, settings.asset, PlainRecord.of(record), settings.method
    ).pack()


def test_the_method_that_was_chosen_decides_whatever_the_gateway_says(
    start_mosquitto, processes, free_port, tmp_path
):
    port, data, case = free_port(), tmp_path / "data", RobustResidual.examples()[0]
    start_mosquitto(port)
    mqtt = f"mqtt://127.0.0.1:{port}"
    store = DiskStore(data, f"sqlite:///{data / 'residuum.db'}")
    RobustResidual().fit(case.training).save(tmp_path / "trained")
    for asset in ("plant", "other"):
        store.add_model_version(asset, "baseline", (tmp_path / "trained").read_bytes())
        store.ensure_asset(asset, diagnoser="robust-residual")
    choose_method(store, "plant", "source", "somebody")
    gateway = Gateway("hall-1", Spool(tmp_path / "spool", 2**30), broker_address(mqtt))
    for asset in ("plant", "other"):
        said = {"diagnoser": "robust-residual", "method": "default"}
        gateway.handle(machine(asset).model_copy(update=said), case.faulty[0], "", None)
    gateway.start()
    try:
        processes.append(start_scorer("1/1", mqtt, data))
        wait_for(lambda: gateway.status()["waiting"] == 0, gateway.status)
    finally:
        gateway.stop()
    found = {
        a: store.finding_of(store.windows(a).items[0].id).finding.evidence["method"]
        for a in ("plant", "other")
    }
    assert found == {"plant": "source", "other": "default"}
    store.close()


def test_a_spool_keeps_its_messages_over_a_crash_and_lets_the_oldest_go_when_it_is_full(tmp_path):
    spool = Spool(tmp_path, 1000)
    keys = [spool.put(bytes([number]) * 300, "press-1") for number in range(5)]
    assert (spool.dropped, spool.oldest(9)) == (2, {"press-1": keys[2:]})
    (tmp_path / "unfinished.part").write_bytes(b"half")
    again = Spool(tmp_path, 1000)
    assert again.oldest(9) == {"press-1": keys[2:]} and again.read(keys[3]) == b"\x03" * 300
    assert len(list(tmp_path.iterdir())) == 3
    assert again.remove(keys[2]) and not again.remove(keys[2]) and again.read(keys[2]) is None
    new = again.put(b"new", "hall-1.press_2")
    assert (
        again.oldest(9)
        == Spool(tmp_path, 1000).oldest(9)
        == {"press-1": [keys[3], keys[4]], "hall-1.press_2": [new]}
    )
    assert again.oldest(1) == {"press-1": [keys[3]], "hall-1.press_2": [new]}
    assert again.remove(new) and again.oldest(9) == {"press-1": [keys[3], keys[4]]}


def test_windows_that_wait_for_their_scorer_hold_up_no_other_machine(
    start_mosquitto, free_port, tmp_path
):
    mqtt = pytest.importorskip(
        "paho.mqtt.client", reason="the extra 'mqtt' is not installed: MQTT was not tried"
    )
    port = free_port()
    start_mosquitto(port)
    gateway = Gateway(
        "hall-1",
        Spool(tmp_path, 2**30),
        broker_address(f"mqtt://127.0.0.1:{port}/plant-7"),
        resend_after=1.0,
    )
    for number in range(40):
        gateway.handle(machine("press-1"), window(number), "", None)  # its scorer is away
    gateway.handle(machine("press-2"), window(0), "", None)
    subscribed = threading.Event()

    def store(client, _data, message):
        if WindowMessage.unpack(message.payload).asset == "press-2":
            confirm(client, message)

    scorer = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
    scorer.on_message, scorer.on_subscribe = store, lambda *_: subscribed.set()
    scorer.connect("127.0.0.1", port)
    scorer.loop_start()
    scorer.subscribe("plant-7/windows/#", qos=1)
    try:
        assert subscribed.wait(PATIENCE)
        gateway.start()
        wait_for(lambda: gateway.status()["stored"] == 1, gateway.status)
    finally:
        gateway.stop()
        scorer.disconnect()
        scorer.loop_stop()
    assert gateway.status()["waiting"] == 40


def test_a_message_holds_the_window_to_the_bit():
    record = Record(
        {"a": np.array([0.1, np.nan], np.float32), "b": np.array([1e-300, -0.0])},
        {"a": "g", "b": "V"},
        1e-4,
        t0=7.5,
    )
    message = WindowMessage("press-1", "bearing", "press", PlainRecord.of(record))
    back = WindowMessage.unpack(message.pack())
    assert (back.asset, back.diagnoser, back.baseline, back.window.t0) == (
        "press-1",
        "bearing",
        "press",
        7.5,
    )
    for name in record.names:
        assert back.window.record()[name].dtype == record[name].dtype
        np.testing.assert_array_equal(back.window.record()[name], record[name])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"version": 2}, "is of version 2"),
        ({"asset": "../etc"}, "is no name of a machine"),
        ({"channels": {"y": ["|O", b"x" * 8]}}, "known are"),
        ({"channels": {"y": ["<f8", b"x" * 7]}}, "cannot be read"),
        ({"channels": 7}, "cannot be read"),
        ({"sample_time": None}, "cannot be read"),
    ],
)
def test_what_is_no_message_is_refused_in_one_line(change, says):
    good = msgpack.unpackb(WindowMessage("a", "bearing", "a", PlainRecord.of(window(0))).pack())
    with pytest.raises(BadInput, match=says) as refused:
        WindowMessage.unpack(msgpack.packb(good | change))
    assert "\n" not in str(refused.value)
    with pytest.raises(BadInput, match="cannot be read"):
        WindowMessage.unpack(b"\xc1 no message")


def test_every_machine_has_one_scorer_however_many_there_are():
    for parts in (1, 2, 3, 64):
        shares = [set(windows_of_part("p", part, parts)) for part in range(1, parts + 1)]
        assert all(shares) and sum(map(len, shares)) == len(set().union(*shares)) == PARTITIONS
    assert window_topic("p", "press-1", "g", "k") == f"p/windows/{partition_of('press-1')}/g/k"


def test_commands_without_a_broker_are_refused(capsys, monkeypatch, tmp_path):
    assert (
        run(["scorer", "--data", str(tmp_path)]) == 2 and "setting mqtt" in capsys.readouterr().err
    )
    assert (
        run(["gateway", "--data", str(tmp_path)]) == 2
        and "needs a broker" in capsys.readouterr().err
    )
    monkeypatch.setenv("RESIDUUM_MQTT", "mqtt://127.0.0.1:1")
    assert (
        run(["scorer", "--part", "3/2", "--data", str(tmp_path)]) == 2
        and "numbered from 1" in capsys.readouterr().err
    )
    assert (
        run(["scorer", "--part", "one", "--data", str(tmp_path)]) == 2
        and "must be K/N" in capsys.readouterr().err
    )


def test_a_machines_name_is_no_longer_than_the_database_keeps():
    """PostgreSQL refuses a longer one, and a window that is refused for ever would hold up its scorer."""
    with pytest.raises(ValueError, match="at most 64"):
        machine("a" * 65)
    long = WindowMessage("a" * 65, "bearing", "a", PlainRecord.of(window(0)))
    with pytest.raises(BadInput, match="is no name of a machine"):
        WindowMessage.unpack(long.pack())
