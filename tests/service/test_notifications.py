"""Alarms reach webhooks and an MQTT broker, also after either was away; nobody waits for them."""

import contextlib
import io
import json
import os
import queue
import sqlite3
import subprocess
import sys
import threading
from datetime import timedelta
from http.server import BaseHTTPRequestHandler, HTTPServer

import httpx
import numpy as np
import pytest

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.notifications import Receiver
from residuum.service.settings import BadSettings, load_settings
from residuum.service.storage import DiskStore
from residuum.service.storage.retention import Retention

OCTETS = {"Content-Type": "application/octet-stream"}


def see(service, verdict):
    return see_in(service.services.store, "press", verdict)


def see_in(store, asset, verdict):
    record = Record({"y": [0.0, 1.0]}, {"y": "V"}, 1.0)
    return store.add_window(asset, record, Finding("bearing", verdict, reason="-"))


@pytest.fixture
def store_urls(tmp_path, new_postgresql_database):
    return f"sqlite:///{tmp_path / 'residuum.db'}", new_postgresql_database()


class Hook:
    """An HTTP server that answers with the given statuses, then 204, and keeps what it was told."""

    def __init__(self, port, statuses=()):
        answers, told = list(statuses), queue.Queue()

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self):
                body = self.rfile.read(int(self.headers["Content-Length"]))
                status = answers.pop(0) if answers else 204
                if status == 204:
                    told.put(json.loads(body))
                self.send_response(status)
                if status in range(300, 400):
                    self.send_header("Location", "/elsewhere")
                self.end_headers()

            def do_GET(self):
                self.send_response(200)
                self.end_headers()

            def log_message(self, *_):
                """Say nothing."""

        self.told = told
        self.server = HTTPServer(("127.0.0.1", port), Handler)
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def stop(self):
        self.server.shutdown()
        self.server.server_close()


def test_a_webhook_that_was_away_and_one_that_fails_get_every_alarm_in_order(
    run_service, free_port
):
    port = free_port()
    service = run_service(webhooks=[f"http://127.0.0.1:{port}/secret?token=x"])
    see(service, "faulty")
    see(service, "healthy")
    hook = Hook(port, statuses=[500, 503])
    states = [hook.told.get(timeout=60)["state"] for _ in range(2)]
    hook.stop()
    assert states == ["unacknowledged", "returned-unacknowledged"]


def test_an_alarm_of_a_service_that_was_killed_is_told_by_the_next_one(
    run_service, free_port, tmp_path
):
    hook_port, port = free_port(), free_port()
    webhooks = [f"http://127.0.0.1:{hook_port}/"]
    environment = {
        **os.environ,
        "RESIDUUM_WEBHOOKS": json.dumps(webhooks),
        "RESIDUUM_LOG_LEVEL": "error",
    }
    command = [
        sys.executable,
        "-c",
        "from residuum.service.cli import main; main()",
        "serve",
        "--port",
        str(port),
    ]
    np.save(body := io.BytesIO(), np.arange(100.0))
    with subprocess.Popen(
        [*command, "--data", str(tmp_path)], env=environment, stdout=subprocess.PIPE, text=True
    ) as killed:
        try:
            assert "Residuum is at" in killed.stdout.readline()
            path = "/api/v1/assets/press/windows?diagnoser=bearing&channel=a%20%5Bm%2Fs%C2%B2%5D&sample_time=1e-3"
            answer = httpx.post(
                f"http://127.0.0.1:{port}{path}",
                content=body.getvalue(),
                headers=OCTETS,
                timeout=120,
            )
            assert (
                answer.status_code == 201
                and answer.json()["finding"]["verdict"] == "not-assessable"
            )
        finally:
            killed.kill()
    hook = Hook(hook_port)
    run_service(data=tmp_path, webhooks=webhooks)
    told = hook.told.get(timeout=60)
    hook.stop()
    assert (told["event"], told["kind"], told["asset"], told["state"]) == (
        "alarm",
        "signal",
        "press",
        "unacknowledged",
    )


def test_of_two_processes_one_tells_and_the_other_takes_over(store_urls, tmp_path):
    for url in store_urls:
        stores = [DiskStore(tmp_path / "data", url) for _ in range(2)]
        first, second = (store.outbox for store in stores)
        hook = first.register("http://hook/secret")
        assert second.register("http://hook/secret") == hook and "secret" not in hook
        assert first.next(hook) is None
        for number in range(3):
            see_in(stores[number % 2], "press", ("faulty", "healthy", "faulty")[number])
        notice = first.next(hook)
        assert (notice.number, notice.alarm["state"], notice.passed_over) == (
            1,
            "unacknowledged",
            0,
        )
        assert second.next(hook) is None
        assert first.next(hook) == notice  # until it says that it was told
        first.told(hook, notice)
        assert (
            first.next(hook).alarm["state"] == "returned-unacknowledged"
            and second.next(hook) is None
        )
        first.release()
        again = second.next(hook)
        assert again.number == 2 and first.next(hook) is None
        late = DiskStore(tmp_path / "data", url)
        # it is told what comes from now on
        assert late.outbox.next(late.outbox.register("http://another/")) is None
        for store in (*stores, late):
            store.close()


def test_who_holds_a_receiver_and_dies_holds_it_no_longer(store_urls, tmp_path, monkeypatch):
    monkeypatch.setattr("residuum.service.storage.outbox.HELD", timedelta(seconds=-1))
    for url in store_urls:
        dead, alive = (DiskStore(tmp_path / "data", url) for _ in range(2))
        hook = dead.outbox.register("http://hook/")
        see_in(dead, "press", "faulty")
        assert dead.outbox.next(hook).number == 1 and alive.outbox.next(hook).number == 1
        for store in (dead, alive):
            store.close()


def test_notices_are_bounded_and_what_was_let_go_is_counted(tmp_path, monkeypatch):
    monkeypatch.setattr("residuum.service.storage.outbox.MOST_NOTICES", 5)
    store = DiskStore(tmp_path, f"sqlite:///{tmp_path / 'residuum.db'}")
    hook = store.outbox.register("http://hook/")
    for number in range(12):
        see_in(store, "press", ("faulty", "healthy")[number % 2])
    numbers, passed = [], 0
    while (notice := store.outbox.next(hook)) is not None:
        numbers.append(notice.number)
        passed += notice.passed_over
        store.outbox.told(hook, notice)
    assert numbers == [8, 9, 10, 11, 12] and passed == 7
    store.close()


@pytest.mark.parametrize(
    "alarm", ['{"state": "normal"}', '{"state'], ids=["another value", "no JSON"]
)
def test_a_notice_whose_row_is_damaged_is_told_to_nobody_and_those_behind_it_are(tmp_path, alarm):
    store = DiskStore(tmp_path, f"sqlite:///{tmp_path / 'residuum.db'}")
    told = queue.Queue()
    receiver = Receiver(
        "hook", "http://hook/", lambda _kind, payload: told.put(payload["state"]), findings=False
    )
    store.outbox.register("http://hook/")
    for verdict in ("faulty", "healthy"):
        see_in(store, "press", verdict)
    with contextlib.closing(sqlite3.connect(tmp_path / "residuum.db")) as connection, connection:
        connection.execute("UPDATE alarm_notices SET alarm = ? WHERE number = 1", (alarm,))
    receiver.start(store.outbox)
    assert told.get(timeout=60) == "returned-unacknowledged"
    receiver.stop()
    assert receiver.dropped == 1 and told.empty()
    store.close()


def test_findings_wait_in_the_database_until_each_receiver_was_told(store_urls, tmp_path):
    for url in store_urls:
        store, other = (DiskStore(tmp_path / "data", url) for _ in range(2))
        see_in(store, "press", "healthy")
        broker = store.outbox.register("mqtt://broker", findings=True)
        later, hook = (
            store.outbox.register("mqtt://later", findings=True),
            store.outbox.register("http://hook/"),
        )
        windows = [see_in(store, "press", verdict) for verdict in ("healthy", "faulty", "healthy")]
        store.close()
        store = DiskStore(tmp_path / "data", url)
        first = store.outbox.findings(broker)
        assert [finding.window for finding in first.findings] == windows and first.lost == 0
        assert other.outbox.findings(broker).findings == []  # while the first process tells it
        store.outbox.told_findings(broker, [finding.id for finding in first.findings[:2]])
        assert [finding.window for finding in store.outbox.findings(broker).findings] == windows[2:]
        assert [finding.window for finding in store.outbox.findings(later).findings] == windows
        assert store.outbox.findings(hook).findings == []
        store.close()
        other.close()


def test_findings_that_wait_are_bounded_and_what_was_let_go_is_counted_once(
    store_urls, tmp_path, monkeypatch
):
    monkeypatch.setattr("residuum.service.storage.rows.finding_notices.MOST_NOTICES_OF_FINDINGS", 5)
    for url in store_urls:
        store = DiskStore(tmp_path / "data", url)
        broker = store.outbox.register("mqtt://broker", findings=True)
        windows = [see_in(store, "press", "healthy") for _ in range(12)]
        batch = store.outbox.findings(broker)
        assert [finding.window for finding in batch.findings] == windows[-5:] and batch.lost == 7
        store.outbox.told_findings(broker, [batch.findings[0].id], batch.lost)
        assert store.outbox.findings(broker).lost == 0
        # rows that go are told no more, and the newest stays
        store.retain(Retention(0.0, 0, 0.0, 0))
        batch = store.outbox.findings(broker)
        assert [finding.window for finding in batch.findings] == windows[-1:] and batch.lost == 3
        store.close()


def test_a_webhook_that_refuses_is_not_asked_again(run_service, free_port):
    port = free_port()
    hook = Hook(port, statuses=[410])
    service = run_service(webhooks=[f"http://127.0.0.1:{port}/"])
    see(service, "faulty")
    see(service, "healthy")
    assert hook.told.get(timeout=60)["state"] == "returned-unacknowledged"
    hook.stop()


def test_a_webhook_that_sends_elsewhere_has_received_nothing(run_service, free_port):
    """A client that followed would ask there without the notification, and take the answer for a receipt."""
    port = free_port()
    hook = Hook(port, statuses=[302])
    service = run_service(webhooks=[f"http://127.0.0.1:{port}/"])
    see(service, "faulty")
    see(service, "healthy")
    assert [hook.told.get(timeout=60)["state"] for _ in range(2)] == [
        "unacknowledged",
        "returned-unacknowledged",
    ]
    hook.stop()


def test_alarms_and_findings_reach_a_broker_that_came_later(
    run_service, start_mosquitto, free_port
):
    """Also the findings of a service that ended before the broker came."""
    mqtt = pytest.importorskip(
        "paho.mqtt.client", reason="the extra 'mqtt' is not installed: MQTT was not tried"
    )
    port = free_port()
    service = run_service(mqtt=f"mqtt://127.0.0.1:{port}/plant-7")
    early = see(service, "faulty")
    service.stop()
    start_mosquitto(port)
    told, subscribed = queue.Queue(), threading.Event()
    client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
    client.on_message = lambda _client, _data, message: told.put(
        (message.topic, json.loads(message.payload))
    )
    client.on_connect = lambda *_: client.subscribe("plant-7/#", qos=1)
    client.on_subscribe = lambda *_: subscribed.set()
    client.connect("127.0.0.1", port)
    client.loop_start()
    try:
        assert subscribed.wait(60)
        service.start()
        window = see(service, "healthy")
        found = {}
        while window not in found.get("plant-7/assets/press/finding", ()):
            topic, payload = told.get(timeout=60)
            found.setdefault(topic, []).append(payload["window"])
        assert set(found) == {"plant-7/assets/press/alarm", "plant-7/assets/press/finding"}
        assert found["plant-7/assets/press/finding"] == [early, window]
    finally:
        client.disconnect()
        client.loop_stop()


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        ({"mqtt": "tcp://broker"}, "setting mqtt: .* must be mqtt://"),
        ({"mqtt": "mqtt://broker/a/#"}, "must be mqtt://"),
        ({"webhooks": ["ftp://host/x"]}, "setting webhooks"),
        ({"tls_certificate": "a.pem"}, "one of them is not enough"),
    ],
)
def test_settings_that_cannot_be_are_refused(setting, says):
    with pytest.raises(BadSettings, match=says):
        load_settings(**setting)
