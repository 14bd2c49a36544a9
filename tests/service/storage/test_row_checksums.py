"""A value that changed in a window's or finding's row is told at each read; none is answered with another value."""

import numpy as np
import pytest
from sqlalchemy import text

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.storage import DiskStore
from residuum.service.storage.database import Database
from residuum.service.storage.rows.row_checks import check_rows
from residuum.service.store import StorageUnavailable

ODD = {"big": 1e22, "whole": 3.0, "minus nothing": -0.0, "none": None, "small": 5e-324, "third": 1 / 3}


@pytest.fixture(params=["sqlite", "postgresql"])
def url(request, tmp_path):
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path / 'store.db'}"
    return request.getfixturevalue("new_postgresql_database")()


@pytest.fixture
def store(tmp_path, url):
    store = DiskStore(tmp_path, url)
    for k in range(3):
        said = Finding(
            "bearing", "healthy", None, {"rms": 0.5 + k} | ODD, {"rms": 9.0}, {"rms": "m/s²"}, {"bands": [1, 2.5, {"a": k}]}, "ä"
        )
        store.add_window("press", Record({"u": np.arange(5.0)}, {"u": "V"}, 0.1, t0=0.1 * k, source="can0"), said)
    yield store
    store.close()


def changed(url, table, column, value):
    database = Database(url)
    with database.write() as connection:
        connection.execute(text(f"UPDATE {table} SET {column} = :value WHERE id = 2"), {"value": value})
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
def test_a_findings_value_that_changed_is_told_and_the_list_goes_on(store, url, column, value, in_history):
    wrong = changed(url, "findings", column, value)
    assert wrong == ["finding 2 of 'press': its row differs from its checksum"]
    newest, damaged, oldest = store.findings("press").items
    assert (newest.finding.verdict, oldest.finding.verdict) == ("healthy", "healthy")
    assert damaged.finding.verdict == "not-assessable" and not damaged.finding.indicators
    assert "finding 2: its row differs from its checksum" in damaged.finding.reason
    assert store.indicators("press", 10).indicators["rms"] == ([0.5, 1.5, 2.5] if in_history else [0.5, 2.5])


@pytest.mark.parametrize(("column", "value"), [("t0", 7.0), ("n", 4), ("sample_time", 0.2), ("source", "can1")])
def test_a_windows_value_that_changed_is_refused(store, url, column, value):
    assert "window 2 of 'press': its row differs from its checksum" in changed(url, "windows", column, value)
    for asked in (lambda: store.window("press", 2), lambda: store.window_record("press", 2), lambda: store.windows("press")):
        with pytest.raises(StorageUnavailable, match="row of window 2 differs from its checksum"):
            asked()
    assert store.window("press", 3).t0 == 0.2
