"""Findings offered as nodes, and a simulated machine that offers itself over OPC UA."""

import asyncio
import contextlib
import gc
import socket
import threading
import time
from datetime import UTC, datetime

import numpy as np
import pytest

pytest.importorskip("asyncua")
from asyncua import Client
from asyncua.crypto.cert_gen import setup_self_signed_certificate
from asyncua.ua import UaError
from asyncua.ua.uaerrors import BadUserAccessDenied
from cryptography.x509.oid import ExtendedKeyUsageOID

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.cli import DONE, run
from residuum.service.fieldbus.opcua.node_map import NodeMap
from residuum.service.fieldbus.opcua.opcua_source import OpcuaSource, enter, make_client
from residuum.service.finding_nodes import FindingNodes
from residuum.service.security.access import new_key
from residuum.service.settings import BadSettings, load_settings
from residuum.service.simulated.device import Device
from residuum.service.simulated.wiring import wiring_of
from residuum.simulation import MACHINES


@pytest.fixture(autouse=True)
def nothing_left():
    """What a loop leaves is collected here, not in the middle of another test."""
    yield
    gc.collect()


ALARM = {
    "asset": "press-1",
    "kind": "machine",
    "state": "normal",
    "condition": False,
    "message": "glr is 2.4 times its threshold",
    "acknowledged_at": None,
}


def address():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"opc.tcp://127.0.0.1:{probe.getsockname()[1]}/"


async def values(url, *nodes):
    async with Client(url) as client:
        return [await client.get_node(f"ns=2;s={node}").read_data_value() for node in nodes]


async def written(url, node):
    async with Client(url.replace("//", "//admin@")) as client:
        await client.get_node(f"ns=2;s={node}").write_value("healthy")


def test_the_latest_finding_is_offered():
    url, at = address(), datetime(2026, 11, 25, 1, 2, 3, tzinfo=UTC)
    nodes = FindingNodes(url)
    nodes.start()
    finding = {
        "asset": "press-1",
        "at": at,
        "verdict": "faulty",
        "class": "wear",
        "reason": "why",
        "indicators": {"glr": 14.5},
    }
    nodes.tell("finding", finding | {"verdict": "healthy"})
    nodes.tell("finding", finding)
    nodes.tell("alarm", ALARM | {"state": "active", "raised_at": at})
    nodes.tell("model", {})
    end, found = time.monotonic() + 60, []
    while [each.Value.Value for each in found[2:]] != ["active"] and time.monotonic() < end:
        with contextlib.suppress(UaError):  # a node is made with its first value
            found = asyncio.run(
                values(url, "press-1.verdict", "press-1.indicator.glr", "press-1.alarm")
            )
    verdict, glr, alarm = found
    assert (verdict.Value.Value, glr.Value.Value, alarm.Value.Value) == ("faulty", 14.5, "active")
    assert verdict.SourceTimestamp.replace(tzinfo=UTC) == at
    with pytest.raises(BadUserAccessDenied):
        asyncio.run(written(url, "press-1.verdict"))
    with pytest.raises(OSError, match="OPC UA server at"):
        FindingNodes(url).start()
    nodes.stop()


class Heard(list):
    """The events of a subscription."""

    def event_notification(self, event):
        self.append(event)


def test_a_change_of_an_alarm_is_an_event_of_a_condition():
    """As a client for alarms and conditions sees it: it subscribes to the object Server."""
    url, heard = address(), Heard()
    nodes = FindingNodes(url)
    nodes.start()
    changes = [
        {"state": "unacknowledged", "condition": True, "priority": "high"},
        {"state": "shelved", "condition": True, "comment": "revision", "priority": "high"},
        {"state": "normal", "condition": False},
    ]

    async def listen():
        async with Client(url) as client:
            subscription = await client.create_subscription(50, heard)
            kind = client.get_node("i=2915")  # AlarmConditionType
            await subscription.subscribe_alarms_and_conditions(evtypes=kind)
            for number, change in enumerate(changes):
                nodes.tell("alarm", ALARM | change)
                end = time.monotonic() + 60
                while len(heard) <= number and time.monotonic() < end:
                    await asyncio.sleep(0.05)

    asyncio.run(listen())
    nodes.stop()
    first, aside, over = heard
    assert (first.SourceName, first.ConditionName) == ("press-1", "machine")
    assert first.Message.Text == "glr is 2.4 times its threshold" and first.Severity == 800
    assert getattr(first, "ActiveState/Id") is True and getattr(first, "AckedState/Id") is False
    assert aside.SuppressedOrShelved and aside.Comment.Text == "revision" and aside.Retain
    assert getattr(over, "ActiveState/Id") is False and over.ActiveState.Text == "Inactive"
    assert not over.Retain and over.Severity == 500


def test_findings_are_read_by_holders_of_a_key_over_secured_channels_alone(
    run_service, tmp_path, capsys
):
    keys = {name: new_key() for name in ("eva", "cut", "scraper")}
    lines = [
        f"eva viewer {keys['eva'][1]}",
        f"cut viewer {keys['cut'][1]} hall-1",
        f"scraper monitor {keys['scraper'][1]}",
    ]
    (tmp_path / "api_keys").write_text("\n".join(lines))
    url = address()
    service = run_service(api_keys=tmp_path / "api_keys", opcua_server=url)
    service.services.store.add_window(
        "press", Record({"y": [0.0]}, {"y": "V"}, 1.0), Finding("bearing", "faulty")
    )
    assert run(["opcua", "trust", url, "--out", str(tmp_path / "server.der")]) == DONE
    certificate = (service.services.settings.data / "opcua" / "server.der").read_bytes()
    assert (tmp_path / "server.der").read_bytes() == certificate
    files = tmp_path / "own.pem", tmp_path / "own.der"
    own = (
        "urn:test:own",
        "localhost",
        [ExtendedKeyUsageOID.CLIENT_AUTH],
        {"organizationName": "test"},
    )
    asyncio.run(setup_self_signed_certificate(*files, *own))
    security = {"certificate": files[1], "key": files[0], "trusted": tmp_path / "server.der"}

    async def read(name, key, policy="Basic256Sha256", writes=False):
        (tmp_path / "password").write_text(key)
        user = {"user": {"name": name, "password_file": tmp_path / "password"}} if name else {}
        safe = {"security": security | {"policy": policy}} if policy else {}
        nodes = NodeMap.model_validate(
            {"streams": {"s": {"sample_time": 1, "channels": {"u": {"node": "i=1"}}}}} | user | safe
        )
        client = make_client(url, nodes, 20.0)
        await enter(client, url, nodes, 20.0)
        try:
            node = client.get_node("ns=2;s=press.verdict")
            if writes:
                await node.write_value("healthy")
            return await node.read_value()
        finally:
            await client.disconnect()

    end, found = time.monotonic() + 60, None
    while found != "faulty" and time.monotonic() < end:
        with contextlib.suppress(UaError):  # a node is made with its first value
            found = asyncio.run(read("eva", keys["eva"][0]))
    assert found == "faulty"
    assert asyncio.run(read("eva", keys["eva"][0], "Aes256Sha256RsaPss")) == "faulty"
    with pytest.raises(BadUserAccessDenied):
        asyncio.run(read("eva", keys["eva"][0], writes=True))
    wrong = [
        ("eva", keys["cut"][0]),
        ("eva", "guess"),
        ("cut", keys["cut"][0]),
        ("scraper", keys["scraper"][0]),
        (None, ""),
    ]
    for name, key in wrong:
        with pytest.raises(UaError):
            asyncio.run(read(name, key))
    for name, key in (("eva", keys["eva"][0]), (None, "")):
        with pytest.raises((UaError, OSError, TimeoutError)):
            asyncio.run(read(name, key, policy=None))


def test_without_keys_findings_are_offered_only_where_it_is_said(tmp_path):
    with pytest.raises(BadSettings, match="set api_keys; or opcua_anonymous"):
        load_settings(opcua_server=address())
    assert load_settings(opcua_server=address(), opcua_anonymous=True).opcua_anonymous


def test_a_simulated_machine_is_read_over_opc_ua():
    url = address()
    device = Device(
        MACHINES["process"](seed=1, exemplar=0),
        wiring_of("process-plant"),
        None,
        None,
        1.0,
        print,
        url,
    )
    loop, stopped = asyncio.new_event_loop(), asyncio.Event()
    thread = threading.Thread(
        target=lambda: loop.run_until_complete(device.run(stopped, lambda port: None)), daemon=True
    )
    thread.start()
    channels = {n: {"node": f"ns=2;s=process.signals.{n}"} for n in ("u", "y")}
    blocks, nodes = (
        [],
        NodeMap.model_validate({"streams": {"s": {"sample_time": 0.1, "channels": channels}}}),
    )
    source = OpcuaSource(url, nodes, lambda b: blocks.append(b) or True)
    source.start()
    end = time.monotonic() + 60
    while sum(b.n for b in blocks) < 20 and time.monotonic() < end:
        time.sleep(0.05)
    source.stop()
    source.join()
    loop.call_soon_threadsafe(stopped.set)
    thread.join(20)
    loop.close()
    y = np.concatenate([b.channels["y"] for b in blocks])
    assert len(y) >= 20 and np.isfinite(y).mean() > 0.8
