"""A value that changed in a row is told at each read; none is answered with another value.

All places and tables at random: `python -m benchmarks.flipped_bytes`, of which a small part is here.
"""

import math

import numpy as np
import pytest
from sqlalchemy import text

from benchmarks.flipped_bytes import campaign
from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.alarms.alarm_states import AlarmEvent
from residuum.service.storage import DiskStore
from residuum.service.storage import database as database_module
from residuum.service.storage.database import Database
from residuum.service.storage.retention import Retention
from residuum.service.storage.rows.row_checks import check_rows
from residuum.service.store import StorageUnavailable

ODD = {
    "big": 1e22,
    "whole": 3.0,
    "minus nothing": -0.0,
    "none": None,
    "small": 5e-324,
    "third": 1 / 3,
}


@pytest.fixture
def store(tmp_path, url):
    store = DiskStore(tmp_path, url)
    for k in range(3):
        said = Finding(
            "bearing",
            "healthy",
            None,
            {"rms": 0.5 + k} | ODD,
            {"rms": 9.0},
            {"rms": "m/s²"},
            {"bands": [1, 2.5, {"a": k}]},
            "ä",
        )
        store.add_window(
            "press", Record({"u": np.arange(5.0)}, {"u": "V"}, 0.1, t0=0.1 * k, source="can0"), said
        )
    yield store
    store.close()


def changed(url, table, column, value, which="id = 2"):
    database = Database(url)
    with database.write() as connection:
        connection.execute(
            text(f"UPDATE {table} SET {column} = :value WHERE {which}"), {"value": value}
        )
    with database.read() as connection:
        wrong = check_rows(connection).wrong
    database.close()
    return wrong


def test_whole_rows_are_told_whatever_their_values(store, url):
    assert [f.finding.verdict for f in store.findings("press").items] == ["healthy"] * 3
    assert store.findings("press").items[0].finding.indicators["third"] == 1 / 3
    assert [w.t0 for w in store.windows("press").items] == [0.2, 0.1, 0.0]
    assert store.indicators("press", 10).indicators["rms"] == [0.5, 1.5, 2.5]
    database = Database(url)
    with database.read() as connection:
        assert check_rows(connection).wrong == []
    database.close()


@pytest.mark.parametrize(
    ("column", "value", "in_history"),
    [
        ("verdict", "faulty", False),
        ("indicators", '{"rms": 1.6}', False),
        ("fault_class", "outer", False),
        ("reason", "e", True),
        ("evidence", "{}", True),
    ],
)
def test_a_findings_value_that_changed_is_told_and_the_list_goes_on(
    store, url, column, value, in_history
):
    wrong = changed(url, "findings", column, value)
    assert wrong == ["finding 2 of 'press': its row differs from its checksum"]
    newest, damaged, oldest = store.findings("press").items
    assert (newest.finding.verdict, oldest.finding.verdict) == ("healthy", "healthy")
    assert damaged.finding.verdict == "not-assessable" and not damaged.finding.indicators
    assert "finding 2: its row differs from its checksum" in damaged.finding.reason
    assert store.indicators("press", 10).indicators["rms"] == (
        [0.5, 1.5, 2.5] if in_history else [0.5, 2.5]
    )


@pytest.mark.parametrize("url", ["sqlite"], indirect=True)
@pytest.mark.parametrize("column", ["indicators", "evidence"])
def test_a_document_that_is_no_json_any_more_is_its_rows_damage_alone(store, url, column):
    waiting = store.outbox.register("mqtt://broker", findings=True)
    add(store, HEALTHY)
    add(store, HEALTHY)
    assert f"finding 4 of 'press': its {column} are no object of names to values" in changed(
        url, "findings", column, '{"rms": 0.5', "id = 4"
    )
    newest, damaged, *_ = store.findings("press").items
    assert (
        newest.finding.indicators == {"rms": 0.5}
        and "its row differs from its checksum" in damaged.finding.reason
    )
    told = store.outbox.findings(waiting).findings
    assert [finding.finding.verdict for finding in told] == ["not-assessable", "healthy"]


@pytest.mark.parametrize(
    ("column", "value"),
    [("t0", 7.0), ("n", 4), ("sample_time", 0.2), ("source", "can1"), ("checksum", None)],
)
def test_a_windows_value_that_changed_is_refused(store, url, column, value):
    assert "window 2 of 'press': its row differs from its checksum" in changed(
        url, "windows", column, value
    )
    for asked in (
        lambda: store.window("press", 2),
        lambda: store.window_record("press", 2),
        lambda: store.windows("press"),
    ):
        with pytest.raises(StorageUnavailable, match="window 2: its row differs from its checksum"):
            asked()
    assert store.window("press", 3).t0 == 0.2


FAULTY = Finding(
    "bearing", "faulty", "outer", {"rms": 9.5}, {"rms": 9.0}, {"rms": "m/s²"}, reason="it knocks"
)
HEALTHY = Finding("bearing", "healthy", None, {"rms": 0.5}, {"rms": 9.0}, {"rms": "m/s²"})


def add(store, finding):
    store.add_window("press", Record({"u": np.arange(5.0)}, {"u": "V"}, 0.1), finding)


@pytest.fixture
def alarm(store):
    add(store, FAULTY)
    store.operate_alarm(1, AlarmEvent.ACKNOWLEDGE, "operator", "seen")
    return store.alarm(1)


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("message", "it sings"),
        ("state", "normal"),
        ("comment", "sees"),
        ("occurrences", 2),
        ("acknowledged_by", "x"),
        ("checksum", None),
    ],
)
def test_an_alarms_value_that_changed_is_told_and_the_alarm_begins_anew(
    store, url, alarm, column, value
):
    assert alarm.state == "acknowledged" and alarm.message.startswith("it knocks")
    assert "alarm 1 of 'press': its row differs from its checksum" in changed(
        url, "alarms", column, value, "id = 1"
    )
    told = store.alarm(1)
    assert told.state == "unacknowledged" and told.message.startswith(
        "alarm 1: its row differs from its checksum"
    )
    with pytest.raises(StorageUnavailable, match="alarm 1, which begins anew"):
        store.operate_alarm(1, AlarmEvent.SHELVE, "operator")
    add(store, FAULTY)
    again = store.alarm(1)
    assert (again.state, again.occurrences) == ("unacknowledged", 1) and again.message.startswith(
        "it knocks"
    )
    assert [entry.event for entry in store.alarm_journal(1)] == [
        "raise",
        "reset",
        "acknowledge",
        "raise",
    ]
    assert "begins anew" in store.alarm_journal(1)[1].comment


def test_whole_rows_of_all_tables_are_whole_on_either_database(store, url, alarm):
    add(store, HEALTHY)
    store.add_record("one", Record({"u": np.arange(5.0)}, {"u": "V"}, 0.1, notes=("a note",)))
    store.add_model_version("drive", "physical", b"a: 1", "a note", "engineer")
    store.ensure_asset("press", "Press 7")
    store.retain(Retention(math.inf, 2**40, math.inf, 2))
    assert store.finding_hours("press")[0].windows == 3
    assert store.alarm(1).state == "normal" and store.asset("press").title == "Press 7"
    assert (
        store.records().items[0].name == "one" and store.model_versions("drive")[0].note == "a note"
    )
    database = Database(url)
    with database.read() as connection:
        assert check_rows(connection).wrong == []
    database.close()


def test_other_tables_tell_too(store, url, alarm):
    record = store.add_record("one", Record({"u": np.arange(5.0)}, {"u": "V"}, 0.1))
    store.add_model_version("drive", "physical", b"a: 1", "a note", "engineer")
    assert changed(url, "alarm_journal", "comment", "not seen") == [
        "entry 2 of alarms' journal: its row differs from its checksum"
    ]
    assert "differs from its checksum" in store.alarm_journal(1)[0].comment
    assert "differs from its checksum" in store.alarm_history().items[0].message
    assert (
        changed(url, "assets", "title", "Pross", "id = 'press'")[-1]
        == "entry 2 of alarms' journal: its row differs from its checksum"
    )
    assert "differs from its checksum" in store.assets().items[0].last_finding.finding.reason
    changed(url, "records", "name", "two", f"id = {record}")
    changed(url, "model_versions", "note", "a vote", "number = 1")
    assert "notice 2 of an alarm: its row differs from its checksum" in changed(
        url, "alarm_notices", "alarm", '{"state": "normal"}', "number = 2"
    )
    changed(url, "audit", "subject", "alarm 2", "number = 1")
    for asked in (
        store.records,
        lambda: store.record_samples(record),
        store.models,
        lambda: store.model_versions("drive"),
        store.audit,
    ):
        with pytest.raises(StorageUnavailable, match=r"differs from its checksum|was changed"):
            asked()
    changed(url, "model_versions", "content", b"a: 2", "number = 1")
    with pytest.raises(StorageUnavailable, match="content differs from its checksum"):
        store.model_content("drive")


def test_flipped_bytes_are_told_or_harmless():
    found, where = campaign(pages=6, blocks=200, seed=1)
    assert (
        not where
        and found["signal blocks"]["told"] > 150
        and not found["signal blocks"]["another value"]
    )


@pytest.mark.parametrize(("small", "looks"), [(2**30, 0), (0, 1)])
def test_beside_the_service_rows_are_looked_at_and_the_structure_only_of_a_large_file(
    tmp_path, monkeypatch, small, looks
):
    url, looked = f"sqlite:///{tmp_path / 'store.db'}", []
    store = DiskStore(tmp_path, url)
    add(store, HEALTHY)
    monkeypatch.setattr(database_module, "_SMALL", small)
    monkeypatch.setattr(Database, "damage", lambda _: looked.append(1))
    assert store.look_for_damage() is None and store.troubles() == {} and len(looked) == looks
    changed(url, "findings", "verdict", "faulty", "id = 1")
    assert "finding 1 of 'press': its row differs from its checksum" in store.look_for_damage()
    assert store.troubles()["database"] == store.damage
    store.close()
