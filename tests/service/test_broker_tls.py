"""A broker that speaks TLS alone and lets in who shows a certificate of its authority: by every door, and who is refused."""

import queue
import threading
import time
from functools import partial

import pytest
import yaml

pytest.importorskip(
    "google.protobuf", reason="the extra 'sparkplug' is not installed: MQTT was not tried"
)

from benchmarks.certificates import certificate_and_key
from residuum.diagnosis.finding import Finding
from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.service.broker import BrokerTls, broker_address, connected_client
from residuum.service.cli import DONE, run
from residuum.service.fieldbus import SOURCES
from residuum.service.fieldbus.settings import SourceSettings
from residuum.service.finding_metrics import EdgeNode
from residuum.service.notifications import Broker
from residuum.service.settings import BadSettings, load_settings

# paho leaves the connection of a handshake that failed to the collector
pytestmark = pytest.mark.filterwarnings("ignore:unclosed <ssl.SSLSocket:ResourceWarning")


@pytest.fixture
def broker(start_mosquitto, free_port, tmp_path):
    """The address of one by TLS, and files of its authority, of a client and of an authority that nobody knows."""
    folder, files, port = tmp_path / "certificates", {}, free_port()
    folder.mkdir()
    for name in ("authority", "another"):
        files[name] = certificate_and_key(folder, name)
    for name in ("broker", "client"):
        files[name] = certificate_and_key(folder, name, by=files["authority"])
    lines = [
        f"cafile {files['authority'][0]}",
        f"certfile {files['broker'][0]}",
        f"keyfile {files['broker'][1]}",
    ]
    start_mosquitto(port, *lines, "require_certificate true")
    return f"mqtts://localhost:{port}/plant", files


def named(files, authority="authority"):
    return {
        "ca": str(files[authority][0]),
        "certificate": str(files["client"][0]),
        "key": str(files["client"][1]),
    }


def wait(condition):
    end = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < end, "it never came"
        time.sleep(0.02)


def test_findings_alarms_and_births_go_by_tls(broker, run_service):
    url, files = broker
    came, subscribed = queue.Queue(), threading.Event()
    listener = connected_client(broker_address(url, BrokerTls(**named(files))))
    listener.on_message = lambda _client, _data, message: came.put(message.topic)
    listener.on_subscribe = lambda *_: subscribed.set()
    listener.subscribe("#", qos=1)
    try:
        assert subscribed.wait(60)
        tls = {f"mqtt_{name}": file for name, file in named(files).items()}
        service = run_service(mqtt=url, sparkplug="Plant/Residuum", **tls)
        service.services.store.add_window(
            "press", Record({"y": [0.0, 1.0]}, {"y": "V"}, 1.0), Finding("bearing", "faulty")
        )
        topics = {
            "plant/assets/press/finding",
            "plant/assets/press/alarm",
            "spBv1.0/Plant/NBIRTH/Residuum",
        }
        while topics:
            topics.discard(came.get(timeout=60))
    finally:
        listener.disconnect()
        listener.loop_stop()


def test_a_source_is_read_by_tls_as_its_map_says(broker, tmp_path, capsys):
    url, files = broker
    node = EdgeNode(broker_address(url, BrokerTls(**named(files))), "Plant/Press")
    node.write("Drive", {"u": 0.0}, time.time())
    node.start()
    file, streams = (
        tmp_path / "map.yaml",
        {"s": {"device": "Drive", "sample_time": 0.1, "channels": {"u": {"metric": "u"}}}},
    )

    def source(**tls):
        file.write_text(yaml.safe_dump({"node": "Plant/Press", "streams": streams, "tls": tls}))
        blocks = []
        made = SOURCES["sparkplug"](
            SourceSettings(kind="sparkplug", channel=url, map=str(file)),
            lambda block: blocks.append(block) or True,
        )
        made.start()
        return made, blocks

    try:
        lost, _ = source(**named(files, "another"))
        wait(lambda: "certificate verify failed" in str(lost.health.snapshot()))
        lost.stop()
        entered, blocks = source(**named(files))
        while not blocks:
            node.write("Drive", {"u": time.time()}, time.time())
            time.sleep(0.05)
        entered.stop()
        out = tmp_path / "found.yaml"
        assert (
            run(["sparkplug", "browse", url, "Plant/Press", "--map", str(file), "--out", str(out)])
            == DONE
        )
        assert "Drive" in out.read_text()
        with pytest.raises(BadInput, match="holds no certificate of an authority"):
            source(ca=str(tmp_path / "none.pem"))
    finally:
        node.stop()


def test_who_shows_nothing_or_is_shown_another_is_not_let_in(broker):
    url, files = broker
    let_in = partial(broker_address, url)
    Broker(let_in(BrokerTls(**named(files)))).try_connection()
    # None: the authorities of the system
    for unknown in (BrokerTls(**named(files, "another")), None):
        with pytest.raises(OSError, match="certificate verify failed"):
            Broker(let_in(unknown)).try_connection()
    with pytest.raises(OSError):  # without a certificate of ours it ends the handshake
        Broker(let_in(BrokerTls(ca=files["authority"][0]))).try_connection()


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"mqtt": "mqtts://b", "mqtt_key": "a"}, "one of them is not enough"),
        ({"mqtt": "mqtt://b", "mqtt_ca": "a"}, "write mqtt: mqtts://"),
        ({"mqtt": "mqtt://b", "mqtt_password_file": "a"}, "is the password of a user"),
        ({"mqtt_password_file": "a"}, "is the password of a user"),
    ],
)
def test_settings_that_do_not_fit_are_refused(settings, says):
    with pytest.raises(BadSettings, match=says):
        load_settings(**settings)


def test_the_password_of_a_file_is_shown(tmp_path):
    (tmp_path / "password").write_text("s:cr@t/\n")
    settings = load_settings(
        mqtt="mqtt://eva@broker/plant", mqtt_password_file=tmp_path / "password"
    )
    assert (settings.broker.user, settings.broker.password) == ("eva", "s:cr@t/")
    (tmp_path / "password").unlink()
    with pytest.raises(BadSettings, match="cannot be read"):
        settings.broker  # noqa: B018 - a property that reads
