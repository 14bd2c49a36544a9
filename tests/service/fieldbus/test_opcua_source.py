"""An OPC UA source against a real server: values in their places, bad status missing, lost sessions opened again."""

import asyncio
import gc
import json
import socket
import threading
import time

import numpy as np
import pytest
import yaml

from residuum.service.cli import BAD_INPUT, DONE, run
from residuum.service.fieldbus import SOURCES
from residuum.service.fieldbus.can.frame_layout import BadBusDescription
from residuum.service.fieldbus.opcua.node_map import NodeMap, read_node_map
from residuum.service.fieldbus.settings import SourceSettings

pytest.importorskip("asyncua")
from asyncua import Server, ua
from asyncua.crypto.cert_gen import setup_self_signed_certificate
from cryptography.x509.oid import ExtendedKeyUsageOID

from residuum.service.fieldbus.opcua.node_server import NodeServer
from residuum.service.fieldbus.opcua.opcua_source import (
    OpcuaSource,
    enter,
    make_client,
    server_certificate,
    what_went_wrong,
)

STEP, BAD = 0.02, 37


class Plant:
    """A server in a thread: sample i of the true clock is u = i, y = 2·i; every 37th has a status that is not good."""

    def __init__(self, port):
        self.url = f"opc.tcp://127.0.0.1:{port}/"
        self._stopped, self._ready, self._drop = (
            threading.Event(),
            threading.Event(),
            threading.Event(),
        )
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), daemon=True)
        self._thread.start()
        assert self._ready.wait(60)

    async def _serve(self):
        server = NodeServer(self.url)
        await server.start({"m": ("u", "y")})
        self._ready.set()
        last = int(time.time() / STEP)
        while not self._stopped.is_set():
            now = int(time.time() / STEP)
            for i in range(last + 1, now + 1):
                status = (
                    ua.StatusCodes.UncertainLastUsableValue if i % BAD == 0 else ua.StatusCodes.Good
                )
                await server.write("m", "u", i, i * STEP, status)
                await server.write("m", "y", 2 * i, i * STEP)
            last = now
            if self._drop.is_set():
                self._drop.clear()
                for client in list(server._server.bserver.clients):
                    client.transport.abort()
            await asyncio.sleep(0.01)
        await server.stop()

    def drop(self):
        self._drop.set()

    def stop(self):
        self._stopped.set()
        self._thread.join(20)


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture(scope="module")
def plant():
    made = Plant(free_port())
    yield made
    made.stop()
    gc.collect()  # what a loop leaves is collected here, not in the middle of another test


def node_map(**channels):
    return {
        "streams": {
            "s": {
                "sample_time": STEP,
                "channels": {n: {"node": f"ns=2;s=m.{at}"} for n, at in channels.items()},
            }
        }
    }


def wait(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.02)
    assert condition()


def test_samples_come_in_their_places_and_a_dropped_session_is_opened_again(plant):
    blocks = []
    source = OpcuaSource(
        plant.url,
        NodeMap.model_validate(node_map(u="u", y="y")),
        lambda b: blocks.append(b) or True,
    )
    source.start()
    wait(lambda: sum(b.n for b in blocks) > 80)
    plant.drop()
    wait(lambda: source.health["reconnects"] >= 1)
    before = sum(b.n for b in blocks)
    wait(lambda: sum(b.n for b in blocks) > before + 40)
    source.stop()
    source.join()
    number = np.concatenate([b.number for b in blocks])
    u, y = (np.concatenate([b.channels[name] for b in blocks]) for name in ("u", "y"))
    good = ~np.isnan(u) & ~np.isnan(y)
    assert len(set(number[good] - u[good])) == 1 and np.array_equal(y[good], 2 * u[good])
    assert not np.any(u[good] % BAD == 0) and source.health["bad_status"] >= 1
    assert source.health["lost"] >= number.max() - number.min() + 1 - len(number)


def test_a_node_that_is_not_there_is_told_with_the_nearest(plant):
    source = OpcuaSource(plant.url, NodeMap.model_validate(node_map(u="uu")), lambda b: True)
    source.start()
    wait(lambda: "nearest are ns=2;s=m.u" in source.health.snapshot()["last_trouble"])
    source.stop()
    source.join()


def test_browsing_writes_the_map(plant, tmp_path, capsys):
    out = tmp_path / "nodes.yaml"
    assert (
        run(
            [
                "opcua",
                "browse",
                plant.url,
                "--out",
                str(out),
                "--under",
                "ns=2;s=m.",
                "--every",
                "0.02",
            ]
        )
        == DONE
    )
    channels = read_node_map(out).streams["signals"].channels
    assert {name: each.node for name, each in channels.items()} == {
        "u": "ns=2;s=m.u",
        "y": "ns=2;s=m.y",
    }
    assert run(["opcua", "trust", plant.url, "--out", str(tmp_path / "server.der")]) == BAD_INPUT
    assert "shows no certificate" in capsys.readouterr().err


async def certified(folder, name, use):
    """A certificate of its own for a side of the connection."""
    files = folder / f"{name}.pem", folder / f"{name}.der"
    await setup_self_signed_certificate(
        *files, f"urn:test:{name}", "127.0.0.1", [use], {"organizationName": "test"}
    )
    return files


def test_a_secured_server_is_entered_with_its_own_certificate_and_no_other(tmp_path):
    async def scene():
        key, certificate = await certified(tmp_path, "server", ExtendedKeyUsageOID.SERVER_AUTH)
        await certified(tmp_path, "own", ExtendedKeyUsageOID.CLIENT_AUTH)
        await certified(tmp_path, "other", ExtendedKeyUsageOID.SERVER_AUTH)
        server, url = Server(), f"opc.tcp://127.0.0.1:{free_port()}/"
        await server.init()
        server.set_endpoint(url)
        await server.set_application_uri("urn:test:server")
        await server.load_certificate(certificate)
        await server.load_private_key(key)
        server.set_security_policy([ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt])
        async with server:
            assert await server_certificate(url, 5.0) == certificate.read_bytes()
            for trusted, enters in (("server", True), ("other", False)):
                nodes = read_node_map(secured(tmp_path, trusted))
                client = make_client(url, nodes, 5.0)
                try:
                    await enter(client, url, nodes, 5.0)
                    await client.disconnect()
                except Exception as error:
                    assert not enters and "residuum opcua trust" in what_went_wrong(error), error
                else:
                    assert enters

    asyncio.run(scene())
    gc.collect()


def secured(folder, trusted):
    file = folder / "nodes.yaml"
    names = {
        key: str(folder / name) for key, name in (("certificate", "own.der"), ("key", "own.pem"))
    }
    text = node_map(u="u") | {"security": names | {"trusted": str(folder / f"{trusted}.der")}}
    file.write_text(yaml.safe_dump(text))
    return file


def test_it_is_opened_by_settings(tmp_path):
    file = tmp_path / "nodes.yaml"
    file.write_text("streams: {s: {sample_time: 0.1, channels: {u: {node: 'ns=2;s=a', unit: V}}}}")
    settings = SourceSettings(kind="opcua", channel="opc.tcp://127.0.0.1:1/", map=str(file))
    source = SOURCES["opcua"](settings, lambda b: True)
    assert [(s.name, dict(s.units)) for s in source.streams] == [("s", {"u": "V"})]
    with pytest.raises(ValueError, match=r"for example opc\.tcp"):
        SourceSettings(kind="opcua", channel="127.0.0.1", map=str(file))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("streams: {}", "streams"),
        ("streams: {s: {sample_time: 0.1, channels: {u: {node: Speed}}}}", r"s\.channels\.u\.node"),
        ("streams: [", "not YAML"),
        (
            "streams: {s: {sample_time: 1, channels: {u: {node: i=1}, u: {node: i=2}}}}",
            "'u' is named twice in one place",
        ),
        (
            "streams: {s: {sample_time: 1, channels: {u: {node: i=1}}}}\nsecurity: {certificate: a, key: b}",
            "residuum opcua trust",
        ),
        (
            "streams: {s: {sample_time: 1, channels: {u: {node: i=1}}}}\nuser: {name: a, password_file: /nowhere}",
            "'/nowhere' is not there",
        ),
    ],
)
def test_a_bad_map_is_refused(tmp_path, text, says):
    file = tmp_path / "nodes.yaml"
    file.write_text(text)
    with pytest.raises(BadBusDescription, match=says):
        read_node_map(file)


def test_browsing_marks_what_takes_few_values_and_names_them(tmp_path, capsys):
    """A server reports an enumeration or a boolean when it changes: the map says that its value holds."""
    url, stop, ready = f"opc.tcp://127.0.0.1:{free_port()}/", threading.Event(), threading.Event()

    async def serve():
        server = Server()
        await server.init()
        server.set_endpoint(url)
        space = await server.register_namespace("urn:test:pump")
        kinds = await server.nodes.enum_data_type.add_data_type(
            ua.NodeId("Mode", space), ua.QualifiedName("Mode", space)
        )
        texts = [ua.LocalizedText(text) for text in ("off", "manual", "auto")]
        await kinds.add_property(
            ua.NodeId("Mode.Names", space), ua.QualifiedName("EnumStrings", 0), texts
        )

        async def add(name, value, kind, data_type=None):
            at = ua.NodeId(f"p.{name}", space)
            return await server.nodes.objects.add_variable(
                at, ua.QualifiedName(name, space), value, kind, data_type
            )

        await add("speed", 1.5, ua.VariantType.Double)
        await add("count", 3, ua.VariantType.Int32)
        await add("running", True, ua.VariantType.Boolean)
        await add("mode", 2, ua.VariantType.Int32, kinds.nodeid)
        bare = await server.nodes.enum_data_type.add_data_type(
            ua.NodeId("Bare", space), ua.QualifiedName("Bare", space)
        )
        await add("bare", 1, ua.VariantType.Int32, bare.nodeid)
        state = await add("state", 1, ua.VariantType.UInt16)
        await state.add_property(
            ua.NodeId("p.state.Names", space), ua.QualifiedName("EnumStrings", 0), texts[:2]
        )
        async with server:
            ready.set()
            while not stop.is_set():
                await asyncio.sleep(0.02)

    thread = threading.Thread(target=lambda: asyncio.run(serve()), daemon=True)
    thread.start()
    assert ready.wait(60)
    out = tmp_path / "nodes.yaml"
    assert (
        run(["opcua", "browse", url, "--out", str(out), "--under", "ns=2;s=p.", "--json"]) == DONE
    )
    found = json.loads(capsys.readouterr().out)["channels"]
    assert run(["opcua", "browse", url, "--out", str(out), "--under", "ns=2;s=p."]) == DONE
    said_of = capsys.readouterr().out
    stop.set()
    thread.join(20)
    gc.collect()
    kinds = {name: (each["kind"], each["names"]) for name, each in found.items()}
    assert kinds == {
        "speed": ("number", []),
        "count": ("number", []),
        "running": ("boolean", []),
        "mode": ("enumeration", ["0 off", "1 manual", "2 auto"]),
        "bare": ("enumeration", []),
        "state": ("enumeration", ["0 off", "1 manual"]),
    }
    held = {
        name: each.held for name, each in read_node_map(out).streams["signals"].channels.items()
    }
    assert held == {name: True if kind != "number" else None for name, (kind, _) in kinds.items()}
    assert "ns=2;s=p.mode  enumeration (0 off, 1 manual, 2 auto), held until it changes" in said_of
