"""What scorers store reaches the listeners of a service's live stream, once, and nobody can show them anything else."""

import json
import queue
import threading
import time

import httpx
import numpy as np
import pytest

from residuum.diagnosis.finding import Finding
from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.service.broker import broker_address
from residuum.service.fieldbus.settings import MachineSettings, SourceSettings, WindowSettings
from residuum.service.storage import DiskStore
from residuum.service.window_queue.gateway import Gateway, Spool
from residuum.service.window_queue.scorer import Scorer
from residuum.service.window_queue.stored_windows import StoredNews, Told
from residuum.service.window_queue.window_message import stored_topic
from residuum.service.work.worker_pool import WorkerPool

PATIENCE = 120


def window(number):
    """A window that begins at `number` seconds."""
    return Record(
        {"acceleration": np.random.default_rng(number).normal(size=500)},
        {"acceleration": "m/s²"},
        1e-3,
        t0=float(number),
    )


def machine(asset):
    source = SourceSettings(kind="modbus", port=1, map="process_plant.yaml")
    return MachineSettings(
        asset=asset, diagnoser="bearing", window=WindowSettings(cut="sliding"), sources=[source]
    )


class Listener:
    """Reads the live stream in a thread; `came` gets (kind, payload)."""

    def __init__(self, url, **options):
        self.came, self._connected = queue.Queue(), threading.Event()
        self._client = httpx.Client(base_url=url, timeout=httpx.Timeout(60, read=None), **options)
        threading.Thread(target=self._read, daemon=True).start()
        assert self._connected.wait(PATIENCE)

    def _read(self):
        kind = ""
        try:
            with self._client.stream("GET", "/api/v1/events") as answer:
                self._connected.set()
                for line in answer.iter_lines():
                    name, _, value = line.partition(": ")
                    kind = value if name == "event" else kind
                    if name == "data":
                        self.came.put((kind, json.loads(value)))
        except httpx.HTTPError:
            """The service has stopped."""

    def until(self, wanted):
        """All events up to the first that is wanted."""
        found = []
        end = time.monotonic() + PATIENCE
        while not found or not wanted(*found[-1]):
            found.append(self.came.get(timeout=max(0.1, end - time.monotonic())))
        return found


def finding_of(number):
    return lambda kind, payload: kind == "finding" and payload["window"] == number


def see(store, asset, verdict="healthy"):
    return store.add_window(
        asset, Record({"y": [0.0, 1.0]}, {"y": "V"}, 1.0), Finding("bearing", verdict, reason="-")
    )


@pytest.fixture
def broker_port(start_mosquitto, free_port):
    port = free_port()
    start_mosquitto(port)
    return port


@pytest.fixture
def publisher(broker_port):
    """A client of the broker that may publish anything."""
    mqtt = pytest.importorskip(
        "paho.mqtt.client", reason="the extra 'mqtt' is not installed: MQTT was not tried"
    )
    client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
    client.connect("127.0.0.1", broker_port)
    client.loop_start()
    yield client
    client.disconnect()
    client.loop_stop()


def counted(service):
    lines = httpx.get(f"{service.url}/metrics", timeout=60).text.splitlines()
    found = {
        line.split('"')[1]: float(line.split()[-1])
        for line in lines
        if line.startswith("residuum_stored_messages_total{")
    }
    return {**dict.fromkeys(("taken", "refused", "overflow"), 0.0), **found}


def wait_for(condition):
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_findings_and_alarms_of_a_scorer_are_told_once_and_in_order_also_after_the_broker_was_away(
    run_service, start_mosquitto, free_port, tmp_path
):
    port = free_port()
    mqtt = f"mqtt://127.0.0.1:{port}/plant-7"
    service = run_service(mqtt=mqtt)
    listener = Listener(service.url)
    broker = start_mosquitto(port)
    listener.until(lambda kind, _: kind == "reset")  # connected
    gateway = Gateway(
        "hall-1", Spool(tmp_path / "spool", 2**30), broker_address(mqtt), resend_after=5.0
    )
    theirs = DiskStore(service.services.settings.data, service.services.settings.database_url)
    pool = WorkerPool(1)
    scorer = Scorer(broker_address(mqtt), 1, 1, pool, theirs, tmp_path / "scorer")
    scorer.start()
    gateway.start()
    try:
        for number in range(20):
            gateway.handle(machine("press-1"), window(number), "", None)
        wait_for(lambda: scorer.stored == 20)
        last = theirs.asset("press-1").last_finding
        told = listener.until(finding_of(last.window))
        assert [payload["id"] for kind, payload in told if kind == "finding"] == list(
            range(last.id - 19, last.id + 1)
        )
        # which is notified over the same broker, too
        own = see(service.services.store, "press-2", "faulty")
        told += listener.until(
            lambda kind, payload: kind == "alarm" and payload["asset"] == "press-2"
        )
        alarms = [
            (payload["asset"], payload["kind"], payload["state"])
            for kind, payload in told
            if kind == "alarm"
        ]
        assert alarms == [
            ("press-1", "signal", "unacknowledged"),
            ("press-2", "machine", "unacknowledged"),
        ]
        assert sum(finding_of(own)(kind, payload) for kind, payload in told) == 1
        broker.kill()
        broker.wait()
        start_mosquitto(port)
        assert [kind for kind, _ in listener.until(lambda kind, _: kind == "reset")] == ["reset"]
        gateway.handle(machine("press-1"), window(20), "", None)
        wait_for(lambda: scorer.stored == 21)
        (newest,) = listener.until(lambda kind, _: kind == "finding")
        assert newest[1]["window"] == theirs.asset("press-1").last_finding.window
    finally:
        gateway.stop()
        scorer.stop()
        pool.terminate()
        theirs.close()


def test_a_message_can_only_say_what_the_store_holds(run_service, broker_port, publisher):
    service = run_service(mqtt=f"mqtt://127.0.0.1:{broker_port}")
    listener = Listener(service.url)
    theirs = DiskStore(service.services.settings.data, service.services.settings.database_url)
    wait_for(publisher.is_connected)
    topic, known = stored_topic("residuum"), see(theirs, "press-1")

    def publish(payload):
        publisher.publish(topic, payload, qos=1).wait_for_publish(PATIENCE)

    def taken(count):
        """Until so many have been taken; the first may come before the service has subscribed."""
        wait_for(lambda: counted(service)["taken"] >= count)

    wait_for(lambda: publish(StoredNews("press-1", known).pack()) or counted(service)["taken"])
    listener.until(finding_of(known))
    before = counted(service)
    garbage = [
        b"",
        b"{",
        b"[1]",
        b"\xff\xfe",
        b"null",
        b'{"asset": "press-1"}',
        b'{"asset": "press-1", "window": true}',
        b'{"asset": "press-1", "window": 1e3}',
        b'{"asset": "press-1", "window": -1}',
        b'{"asset": "press-1", "window": 99999999999999999999}',
        b'{"asset": "../etc", "window": 1}',
        b'{"asset": ["press-1"], "window": 1}',
        b'{"kind": "alarm", "asset": "press-1", "state": "unacknowledged"}',
        b"[" * 400,
        b'{"asset": "press-1", "window": 1, "more": "' + b"x" * 2**20 + b'"}',
    ]
    for payload in garbage:
        publish(payload)
    wait_for(lambda: counted(service)["refused"] == before["refused"] + len(garbage))
    for payload in (
        StoredNews("press-9", 1),
        StoredNews("press-1", 10**9),
        StoredNews("press-1", known),
    ):
        publish(payload.pack())
    taken(before["taken"] + 3)
    own = see(service.services.store, "press-1")
    publish(StoredNews("press-1", own).pack())  # told by the service itself
    taken(before["taken"] + 4)
    newest = see(theirs, "press-1", "faulty")
    publish(StoredNews("press-1", newest).pack())
    told = listener.until(lambda kind, _: kind == "alarm")
    assert [(kind, payload.get("window")) for kind, payload in told] == [
        ("finding", own),
        ("finding", newest),
        ("alarm", newest),
    ]
    theirs.close()


def test_a_flood_of_names_is_bounded_and_what_comes_after_it_is_told(
    run_service, broker_port, publisher, monkeypatch
):
    monkeypatch.setattr("residuum.service.window_queue.stored_windows._MOST_WAITING", 50)
    monkeypatch.setattr("residuum.service.window_queue.stored_windows._AT_ONCE", 10)
    monkeypatch.setattr("residuum.service.window_queue.stored_windows._PAUSE", 0.5)
    service = run_service(mqtt=f"mqtt://127.0.0.1:{broker_port}")
    listener = Listener(service.url)
    theirs = DiskStore(service.services.settings.data, service.services.settings.database_url)
    first = see(theirs, "press-1")
    wait_for(
        lambda: (
            publisher.publish("residuum/stored", StoredNews("press-1", first).pack(), qos=1)
            and counted(service)["taken"]
        )
    )
    listener.until(finding_of(first))
    sent = [
        publisher.publish("residuum/stored", StoredNews(f"none-{k}", 1).pack(), qos=1)
        for k in range(900)
    ]
    for each in sent:
        each.wait_for_publish(PATIENCE)
    listener.until(lambda kind, _: kind == "reset")  # names were left out
    assert counted(service)["overflow"] > 0
    numbers = [see(theirs, "press-1") for _ in range(30)]  # more than are told one by one
    publisher.publish("residuum/stored", StoredNews("press-1", numbers[-1]).pack(), qos=1)
    assert all(kind == "reset" for kind, _ in listener.until(lambda kind, _: kind == "reset"))
    theirs.close()


def test_a_service_whose_broker_is_away_starts_and_stops(run_service, free_port):
    service = run_service(mqtt=f"mqtt://127.0.0.1:{free_port()}")
    service.stop()  # it says when it had to wait in vain
    service.start()


def test_what_was_told_is_not_told_again():
    told = Told(remembered=3)
    assert [told.first(number) for number in (1, 2, 1, 3, 4, 2)] == [
        True,
        True,
        False,
        True,
        True,
        False,
    ]
    assert len(told._numbers) == 3


def test_news_is_small_and_plain():
    with pytest.raises(BadInput, match="at most 500"):
        StoredNews.unpack(StoredNews("a" * 64, 2**62).pack() + b" " * 500)
    assert StoredNews.unpack(StoredNews("a" * 64, 2**62).pack()).window == 2**62
