"""Alarms reach webhooks and an MQTT broker, also after either was away; nobody waits for them."""

import json
import queue
import threading
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.settings import BadSettings, load_settings


def see(service, verdict):
    record = Record({"y": [0.0, 1.0]}, {"y": "V"}, 1.0)
    return service.services.store.add_window("press", record, Finding("bearing", verdict, reason="-"))


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
                self.end_headers()

            def log_message(self, *_):
                """Say nothing."""

        self.told = told
        self.server = HTTPServer(("127.0.0.1", port), Handler)
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def stop(self):
        self.server.shutdown()
        self.server.server_close()


def test_a_webhook_that_was_away_and_one_that_fails_get_every_alarm_in_order(run_service, free_port):
    port = free_port()
    service = run_service(webhooks=[f"http://127.0.0.1:{port}/secret?token=x"])
    see(service, "faulty")
    see(service, "healthy")
    hook = Hook(port, statuses=[500, 503])
    states = [hook.told.get(timeout=60)["state"] for _ in range(2)]
    hook.stop()
    assert states == ["unacknowledged", "returned-unacknowledged"]


def test_a_webhook_that_refuses_is_not_asked_again(run_service, free_port):
    port = free_port()
    hook = Hook(port, statuses=[410])
    service = run_service(webhooks=[f"http://127.0.0.1:{port}/"])
    see(service, "faulty")
    see(service, "healthy")
    assert hook.told.get(timeout=60)["state"] == "returned-unacknowledged"
    hook.stop()


def test_alarms_and_findings_reach_a_broker_that_came_later(run_service, start_mosquitto, free_port):
    mqtt = pytest.importorskip("paho.mqtt.client", reason="the extra 'mqtt' is not installed: MQTT was not tried")
    port = free_port()
    service = run_service(mqtt=f"mqtt://127.0.0.1:{port}/plant-7")
    see(service, "faulty")
    start_mosquitto(port)
    told, subscribed = queue.Queue(), threading.Event()
    client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
    client.on_message = lambda _client, _data, message: told.put((message.topic, json.loads(message.payload)))
    client.on_connect = lambda *_: client.subscribe("plant-7/#", qos=1)
    client.on_subscribe = lambda *_: subscribed.set()
    client.connect("127.0.0.1", port)
    client.loop_start()
    try:
        assert subscribed.wait(60)
        window = see(service, "healthy")
        found = {}
        while len(found) < 2 or found["plant-7/assets/press/finding"]["window"] != window:
            topic, payload = told.get(timeout=60)
            found[topic] = payload
        assert set(found) == {"plant-7/assets/press/alarm", "plant-7/assets/press/finding"}
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
