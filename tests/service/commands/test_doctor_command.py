"""`residuum doctor` says of each thing the service needs whether it is well, and changes nothing."""

import contextlib
import json
import re
import socket
import sqlite3
from dataclasses import replace

import numpy as np
import pytest

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.cli import run
from residuum.service.fieldbus import SOURCES
from residuum.service.settings import SETTINGS_FILE
from residuum.service.storage import DiskStore
from residuum.service.storage.database import Database, known_revisions


@pytest.fixture
def data(tmp_path):
    store = DiskStore(tmp_path, f"sqlite:///{tmp_path / 'residuum.db'}")
    for number in range(3):
        record = Record({"y": np.arange(100.0) + number}, {"y": "V"}, 1e-3)
        store.add_window("a", record, Finding("bearing", "healthy", reason="-"))
    store.close()
    return tmp_path


@pytest.fixture
def examine(capsys):
    def examine(data, *more):
        status = run(["doctor", "--data", str(data), "--json", *more])
        answer = json.loads(capsys.readouterr().out)
        assert answer["ok"] == (status == 0) and status in (0, 1)
        return status, {
            check["name"]: check["says"] for check in answer["checks"] if not check["ok"]
        }

    return examine


def test_a_healthy_installation(data, examine, capsys):
    assert examine(data) == (0, {})
    assert run(["doctor", "--data", str(data)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 8 and all(line.startswith("ok") for line in lines)
    assert (
        "all 3 are there; 3 compared" in lines[3]
        and "7 looked at, all agree" in lines[2]
        and "revision" in lines[0]
    )


def test_before_the_first_start_nothing_is_wrong_and_nothing_is_made(tmp_path, examine):
    assert examine(tmp_path / "new") == (0, {})
    assert not (tmp_path / "new").exists()


def test_a_changed_and_a_missing_block(data, examine):
    first, second, _ = sorted(data.glob("blocks/*/*.block"))
    first.write_bytes(first.read_bytes()[:-1] + b"x")
    status, wrong = examine(data)
    assert status == 1 and list(wrong) == ["signal blocks"] and first.name in wrong["signal blocks"]
    second.unlink()
    assert "1 of 3 are missing" in examine(data)[1]["signal blocks"]


def test_a_schema_of_another_version_is_named_and_left_alone(data, examine):
    database = Database(f"sqlite:///{data / 'residuum.db'}")
    database.migrate("-1")
    status, wrong = examine(data)
    assert status == 1 and f"at revision {known_revisions()[1]}" in wrong["database"]
    assert database.revision() == known_revisions()[1]
    database.close()


def test_a_damaged_database(data, examine):
    (data / "residuum.db").write_bytes(b"no database at all" * 1000)
    status, wrong = examine(data)
    assert status == 1 and "not a database" in wrong["database"]


def test_a_disk_too_small_for_what_is_to_be_kept(data, examine, monkeypatch):
    monkeypatch.setenv("RESIDUUM_KEEP_BYTES", str(2**60))
    assert list(examine(data)[1]) == ["disk"]


def test_a_device_that_does_not_answer_and_one_that_does(data, examine, monkeypatch, tmp_path):
    with socket.socket() as absent, socket.create_server(("127.0.0.1", 0)) as present:
        absent.bind(("127.0.0.1", 0))  # bound and not listening: connections are refused
        sources = [
            {"kind": "modbus", "map": "process_plant.yaml", "port": each.getsockname()[1]}
            for each in (absent, present)
        ]
        machine = {
            "asset": "p",
            "diagnoser": "robust-residual",
            "window": {"cut": "sliding"},
            "sources": sources,
        }
        monkeypatch.setenv("RESIDUUM_MACHINES", json.dumps([machine]))
        status, wrong = examine(data)
    assert (
        status == 1
        and list(wrong) == ["modbus bus"]
        and str(sources[0]["port"]) in wrong["modbus bus"]
    )


def test_a_broker_that_is_away_one_that_refuses_and_one_that_lets_us_in(
    data, examine, monkeypatch, start_mosquitto, free_port
):
    pytest.importorskip(
        "paho.mqtt.client", reason="the extra 'mqtt' is not installed: MQTT was not tried"
    )
    away, closed, opened = (free_port() for _ in range(3))
    start_mosquitto(closed, "allow_anonymous false")
    start_mosquitto(opened)
    for port, says in ((away, "refused"), (closed, "refuses the connection"), (opened, None)):
        monkeypatch.setenv("RESIDUUM_MQTT", f"mqtt://eva:secret@127.0.0.1:{port}/plant-7")
        status, wrong = examine(data)
        assert (status, list(wrong)) == ((0, []) if says is None else (1, ["broker"]))
        assert says is None or (says in wrong["broker"] and "secret" not in wrong["broker"])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ("UPDATE windows SET n = 0 WHERE id = 2", "window 2 of 'a': has 0 samples"),
        (
            "UPDATE windows SET n = 1000000 WHERE id = 2",
            "window 2 of 'a': .* cannot hold 1000000 samples",
        ),
        ("DELETE FROM findings WHERE id = 2", "window 2 of 'a': has no finding"),
        (
            "UPDATE findings SET verdict = 'fine' WHERE id = 1",
            "finding 1 of 'a': its verdict is 'fine'",
        ),
        (
            "UPDATE findings SET evidence = '{' WHERE id = 1",
            "finding 1 of 'a': its evidence are no object",
        ),
        (
            "UPDATE findings SET units = '[1]' WHERE id = 1",
            "finding 1 of 'a': its units are no object",
        ),
        (
            "UPDATE findings SET asset_id = 'b' WHERE id = 3",
            "finding 3 of 'b': its window 3 is of 'a'",
        ),
        ("UPDATE assets SET last_finding_id = 1", "its latest finding is said to be 1 and is 3"),
        ("UPDATE assets SET windows = 1", "asset 'a': counts 1 windows and has 3"),
        (
            "UPDATE alarms SET state = 'normal'",
            "is normal, and its journal ends with unacknowledged",
        ),
        ("UPDATE alarms SET state = 'asleep'", "its state is 'asleep'"),
        ("UPDATE model_versions SET content = x'00'", "model 'm', version 1: its content differs"),
        ("DELETE FROM model_versions WHERE number = 1", "model 'm': has 1 versions and counts 2"),
    ],
)
def test_a_row_that_was_changed_by_hand_is_named(data, examine, change, says):
    store = DiskStore(data, f"sqlite:///{data / 'residuum.db'}")
    store.add_window(
        "b", Record({"y": [0.0, 1.0]}, {"y": "V"}, 1.0), Finding("bearing", "faulty", reason="-")
    )
    for content in (b"one", b"two"):
        store.add_model_version("m", "physical", content)
    store.close()
    assert examine(data) == (0, {})
    with contextlib.closing(sqlite3.connect(data / "residuum.db")) as connection, connection:
        connection.execute(change)
    status, wrong = examine(data)
    assert status == 1 and list(wrong) == ["rows"] and re.search(says, wrong["rows"])


PACK = """VERSION ""
BS_:
BU_: BMS
BO_ 64 wake_up: 0 BMS
BO_ 513 cells: 8 BMS
 SG_ cell_voltage_01 : 8|12@1+ (0.001,0) [0|5] "V" BMS
BO_ 514 current: 8 BMS
 SG_ counter : 0|8@1+ (1,0) [0|255] "" BMS
 SG_ current : 8|16@1- (0.1,0) [0|0] "A" BMS
BA_DEF_ BO_ "SampleTime" FLOAT 0 100;
BA_ "SampleTime" BO_ 514 0.1;
"""


@pytest.mark.parametrize(
    ("text", "status", "says"),
    [
        (
            PACK,
            0,
            "ok .*streams current; of 1 not streamed the first: cells has no time between frames",
        ),
        (
            PACK.replace("counter :", "number :"),
            0,
            "NOTE .*streams current.*current: no counter: losses cannot be seen",
        ),
        (
            PACK.replace('BA_ "SampleTime" BO_ 514 0.1;', ""),
            1,
            "WRONG .*bms.dbc: has nothing to stream: message cells",
        ),
        (
            PACK.replace("8|16@1-", "8|57@1-"),
            1,
            "WRONG .*has nothing to stream: .*current does not fit in message current",
        ),
    ],
)
def test_a_dbc_file_is_said_to_stream_what_it_does(
    data, tmp_path, capsys, monkeypatch, text, status, says
):
    (tmp_path / "bms.dbc").write_text(text)
    source = {"kind": "can", "channel": "virtual:doctor", "map": str(tmp_path / "bms.dbc")}
    machine = {
        "asset": "pack",
        "diagnoser": "robust-residual",
        "window": {"cut": "sliding"},
        "sources": [source],
    }
    (tmp_path / "settings.json").write_text(json.dumps({"machines": [machine]}))
    monkeypatch.setenv(SETTINGS_FILE, str(tmp_path / "settings.json"))
    assert run(["doctor", "--data", str(data)]) in (0, 1)
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "can bus" in line]
    assert re.match(says, line) and (status == 1) == line.startswith("WRONG")


def test_a_kind_of_source_without_a_look_of_its_own_tells_its_streams(data, capsys, monkeypatch):
    """A new kind is one file and one entry; the look of another kind must not judge it."""
    monkeypatch.setitem(SOURCES, "modbus", replace(SOURCES["modbus"], look=None))
    watched = {
        "asset": "plant",
        "diagnoser": "robust-residual",
        "window": {"cut": "sliding"},
        "sources": [{"kind": "modbus", "map": "process_plant.yaml"}],
    }
    monkeypatch.setenv("RESIDUUM_MACHINES", json.dumps([watched]))
    assert run(["doctor", "--data", str(data)]) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "modbus bus" in line]
    assert "process_plant.yaml streams" in line and "was not tried" in line
