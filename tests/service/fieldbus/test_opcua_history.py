"""Records from the history of a real OPC UA server, read by its address."""

import asyncio
import threading
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from asyncua import Server, ua

import residuum as rs
from residuum.identification.errors import BadRecord
from residuum.service.cli import DONE, run

N, BEGIN = 300, datetime(2026, 3, 1, tzinfo=UTC)
SPEED = 100.0 + np.random.default_rng(0).normal(size=N)
OIL = np.round(40.0 + np.random.default_rng(1).normal(size=N // 10))


async def _serve(url, ready, stop):
    server = Server()
    await server.init()
    server.set_endpoint(url)
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    machine = await server.nodes.objects.add_object(2, "Machine")
    speed = await machine.add_variable(ua.NodeId("Speed", 2), "2:speed", 0.0)
    oil = await machine.add_variable(ua.NodeId("Oil", 2), "2:oil", 0)
    words = await machine.add_variable(ua.NodeId("Words", 2), "2:words", "idle")
    units = ua.EUInformation(DisplayName=ua.LocalizedText("rpm"))
    await speed.add_property(0, "EngineeringUnits", units)
    async with server:
        for node in (speed, oil, words):
            await server.historize_node_data_change(node, period=None, count=10 * N)
        kept = server.iserver.history_manager.storage
        for k in range(N):
            at = BEGIN + timedelta(seconds=k)
            status = ua.StatusCode(ua.StatusCodes.Bad if k == 7 else ua.StatusCodes.Good)
            await kept.save_node_value(speed.nodeid, _value(float(SPEED[k]), at, status))
            if k % 10 == 0:
                await kept.save_node_value(oil.nodeid, _value(int(OIL[k // 10]), at))
        await kept.save_node_value(words.nodeid, _value("runs", BEGIN))
        ready.set()
        while not stop.is_set():
            await asyncio.sleep(0.05)


def _value(value, at, status=None):
    return ua.DataValue(ua.Variant(value), status or ua.StatusCode(0), SourceTimestamp=at)


@pytest.fixture(scope="module")
def historian(tmp_path_factory):
    """The address of a server that keeps the history of three nodes."""
    from tests.service.conftest import _free_port

    url = f"opc.tcp://127.0.0.1:{_free_port()}/plant"
    ready, stop = threading.Event(), threading.Event()
    thread = threading.Thread(target=lambda: asyncio.run(_serve(url, ready, stop)))
    thread.start()
    assert ready.wait(120)
    yield url
    stop.set()
    thread.join()


def asked(url, nodes, start="2026-03-01", end="2026-03-02"):
    return f"{url}?nodes={nodes}&start={start}&end={end}"


def test_nodes_are_a_record_with_their_units_and_what_was_bad_is_missing(historian):
    record = rs.read(asked(historian, "ns=2;s=Speed,ns=2;s=Oil"))
    assert (record.names, record.units["speed"]) == (("speed", "oil"), "rpm")
    assert (record.n, record.sample_time, record.t0) == (N, 1.0, BEGIN.timestamp())
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(record["speed"])), [7])
    np.testing.assert_array_equal(np.delete(record["speed"], 7), np.delete(SPEED, 7))
    np.testing.assert_array_equal(record["oil"][::10], OIL)
    assert np.isnan(record["oil"][1])


def test_a_span_holds_its_start_and_not_its_end(historian):
    span = asked(historian, "ns=2;s=Speed", "2026-03-01T00:01", "2026-03-01T00:02")
    record = rs.read(span)
    assert (record.n, record.t0) == (60, BEGIN.timestamp() + 60)


def test_a_command_reads_it_as_a_file(historian, tmp_path, capsys):
    out = tmp_path / "model.json"
    address = asked(historian, "ns=2;s=Speed", "2026-03-01T00:00:10")
    words = ["identify", address, "--output", "speed", "--method", "ar", "--order", "2"]
    assert run([*words, "--out", str(out)]) == DONE, capsys.readouterr().err
    assert out.is_file()


@pytest.mark.parametrize(
    ("nodes", "says"),
    [
        ("ns=2;s=Spead", "BadNodeIdUnknown"),
        ("ns=2;s=Words", "'words' holds no numbers but str; leave it out"),
        ("", "name the nodes to read"),
        ("speed", "speed"),
    ],
)
def test_nodes_that_cannot_be_read_are_refused(historian, nodes, says):
    with pytest.raises(BadRecord, match=says):
        rs.read(asked(historian, nodes))


def test_a_time_without_values_and_an_address_without_a_time_are_refused(historian):
    with pytest.raises(BadRecord, match="no values of 'speed' in that time"):
        rs.read(asked(historian, "ns=2;s=Speed", "2027-03-01", "2027-03-02"))
    with pytest.raises(BadRecord, match="say from when to when"):
        rs.read(f"{historian}?nodes=ns=2;s=Speed")
    with pytest.raises(BadRecord, match="no key 'node'; did you mean 'nodes'"):
        rs.read(f"{historian}?node=ns=2;s=Speed")


def test_a_server_that_does_not_answer_is_told_without_the_password(free_port):
    port = free_port()
    address = asked(f"opc.tcp://me:secret@127.0.0.1:{port}", "i=85")
    with pytest.raises(BadRecord, match=rf"opc.tcp://127.0.0.1:{port}: (?!.*secret)"):
        rs.read(address)
