"""Records from the history of a real OPC UA server, read by its address."""

import asyncio
import threading
from contextlib import closing
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from asyncua import Server, ua

import residuum as rs
from residuum.identification.errors import BadRecord
from residuum.identification.record_formats.histories import HistoryReader, windows_of
from residuum.identification.record_formats.history import HistoryAway
from residuum.service.cli import DONE, run

N, BEGIN = 300, datetime(2026, 3, 1, tzinfo=UTC)
MANY = 10_321  # more than is asked for at a time
KEPT = []  # what the server keeps its history in
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
    many = await machine.add_variable(ua.NodeId("Many", 2), "2:many", 0.0)
    units = ua.EUInformation(DisplayName=ua.LocalizedText("rpm"))
    await speed.add_property(0, "EngineeringUnits", units)
    async with server:
        for node in (speed, oil, words, many):
            await server.historize_node_data_change(node, period=None, count=2 * MANY)
        kept = server.iserver.history_manager.storage
        KEPT.append(kept)
        for k in range(N):
            at = BEGIN + timedelta(seconds=k)
            status = ua.StatusCode(ua.StatusCodes.Bad if k == 7 else ua.StatusCodes.Good)
            await kept.save_node_value(speed.nodeid, _value(float(SPEED[k]), at, status))
            if k % 10 == 0:
                await kept.save_node_value(oil.nodeid, _value(int(OIL[k // 10]), at))
        await kept.save_node_value(words.nodeid, _value("runs", BEGIN))
        for k in range(MANY):
            at = BEGIN + timedelta(seconds=k)
            await kept.save_node_value(many.nodeid, _value(float(k), at))
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
    with pytest.raises(HistoryAway, match=rf"opc.tcp://127.0.0.1:{port}: (?!.*secret)"):
        rs.read(address)


@pytest.mark.parametrize("at_once", [10_000, 700])
def test_no_value_is_lost_where_a_server_gives_them_in_parts(historian, at_once, monkeypatch):
    """This server cuts an answer at what was asked for without a word, and else goes on by points."""
    monkeypatch.setattr(KEPT[0], "max_history_data_response_size", at_once)
    record = rs.read(asked(historian, "ns=2;s=Many"))
    np.testing.assert_array_equal(record["many"], np.arange(MANY))


def test_windows_of_nodes_are_those_of_the_whole_record_in_one_session(historian):
    address = asked(historian, "ns=2;s=Speed,ns=2;s=Oil", end="2026-03-01T00:05") + "&window=100"
    names = windows_of(address)
    whole = rs.read(address.removesuffix("&window=100"))
    with closing(HistoryReader(address)) as reader:
        parts = [reader.read(name) for name in names]
    for name, part in zip(names, parts, strict=True):
        assert (part.source, part.units["speed"]) == (name, "rpm")
        np.testing.assert_array_equal(rs.read(name)["speed"], part["speed"])
    np.testing.assert_array_equal(np.concatenate([part["speed"] for part in parts]), whole["speed"])
    with pytest.raises(BadRecord, match="window asks for several records"):
        rs.read(address)


def test_a_session_that_ended_is_opened_anew(historian):
    address = asked(historian, "ns=2;s=Speed", end="2026-03-01T00:05") + "&window=150"
    names = windows_of(address)
    with closing(HistoryReader(address)) as reader:
        first = reader.read(names[0])
        reader.close()
        np.testing.assert_array_equal(reader.read(names[0])["speed"], first["speed"])


def test_the_windows_of_nodes_are_identified_from_by_the_fleets_command(historian, tmp_path):
    # the first seconds have a value of bad status, which a model is not identified with
    address = asked(historian, "ns=2;s=Speed", "2026-03-01T00:00:10", "2026-03-01T00:05")
    address += "&window=145"
    out = tmp_path / "models.jsonl"
    words = ["reidentify", address, "--output", "speed", "--method", "ar", "--order", "2"]
    assert run([*words, "--out", str(out), "--workers", "1"]) == DONE
    assert out.read_text().count('"model"') == 2
