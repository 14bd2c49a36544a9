"""What was acknowledged is there, whole, whatever happens; the same on SQLite and PostgreSQL."""

import errno
import os
import subprocess
import sys
import threading
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext

from residuum.diagnosis.finding import Finding
from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.service.alarms.alarm_states import ACTIVE, AlarmEvent, AlarmState, IllegalTransition
from residuum.service.settings import BadSettings
from residuum.service.storage import DiskStore
from residuum.service.storage.blocks import BrokenBlock
from residuum.service.storage.database import Database
from residuum.service.storage.tables import metadata
from residuum.service.store import Conflict, NotFound, StorageUnavailable


@pytest.fixture(scope="module")
def postgres(new_postgresql_database):
    return new_postgresql_database()


@pytest.fixture(params=["sqlite", "postgresql"])
def url(request, tmp_path):
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path / 'store.db'}"
    url = request.getfixturevalue("postgres")
    database = Database(url)
    database.migrate()
    database.migrate("base")
    database.close()
    return url


@pytest.fixture
def announced():
    return []


@pytest.fixture
def store(tmp_path, url, announced):
    store = DiskStore(tmp_path, url, lambda kind, payload: announced.append((kind, payload)))
    yield store
    store.close()


def window(seed=0, n=1000):
    rng = np.random.default_rng(seed)
    y = rng.normal(size=n)
    y[17] = np.nan
    channels = {"y": y, "Beschleunigung 🛠": rng.normal(size=n).astype(np.float32)}
    return Record(
        channels,
        {"y": "V", "Beschleunigung 🛠": "m/s²"},
        1e-3,
        t0=12.5,
        notes=("split: 0.7",),
        source="can0",
    )


def finding(verdict="healthy", **more):
    return Finding("bearing", verdict, reason="because", **more)


def test_a_window_comes_back_exactly_as_it_was(store):
    record = window()
    said = finding(
        "faulty",
        fault_class="ball",
        indicators={"rms": 1.5, "odd": float("nan")},
        thresholds={"rms": 1.0},
        units={"rms": "V"},
    )
    number = store.add_window("press-1", record, said)
    back = store.window_record("press-1", number)
    for name in record.names:
        np.testing.assert_array_equal(back[name], record[name])
        assert back[name].dtype == record[name].dtype
    assert (dict(back.units), back.sample_time, back.t0, back.notes) == (
        dict(record.units),
        1e-3,
        12.5,
        ("split: 0.7",),
    )
    assert store.window_record("press-1", number, ["y"]).names == ("y",)
    stored = store.finding_of(number).finding
    assert (stored.verdict, stored.fault_class, stored.thresholds) == (
        "faulty",
        "ball",
        {"rms": 1.0},
    )
    assert stored.indicators == {"rms": 1.5, "odd": None}
    assert store.asset("press-1").last_finding.window == number
    with pytest.raises(NotFound, match="has no window"):
        store.window("press-1", number + 1)


def test_one_key_stores_once_even_when_asked_by_many_at_once(store):
    numbers = []
    threads = [
        threading.Thread(
            target=lambda: numbers.append(
                store.add_window("a", window(), finding(), "key-1", "digest")
            )
        )
        for _ in range(8)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(numbers) == 8 and len(set(numbers)) == 1
    assert len(store.windows("a").items) == 1
    with pytest.raises(Conflict, match="another window"):
        store.add_window("a", window(1), finding(), "key-1", "another digest")
    assert store.add_window("b", window(), finding(), "key-1", "digest") != numbers[0]
    assert store.sweep() == 0


def test_a_full_disk_stores_nothing_and_says_so(store, monkeypatch, tmp_path):
    store.add_window("a", window(), finding())
    real, written = os.write, []

    def full(descriptor, data):
        if len(written) > 2:
            raise OSError(errno.ENOSPC, "No space left on device")
        written.append(1)
        return real(descriptor, data)

    monkeypatch.setattr(os, "write", full)
    with pytest.raises(StorageUnavailable, match="No space left") as refused:
        store.add_window("a", window(1), finding())
    assert refused.value.full
    monkeypatch.undo()
    assert len(store.windows("a").items) == 1 and len(list(tmp_path.glob("blocks/*/*.block"))) == 1


def test_a_failing_transaction_leaves_no_block(store, monkeypatch, tmp_path):
    monkeypatch.setattr("residuum.service.storage.rows.alarms.follow", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        store.add_window("a", window(), finding("faulty"))
    assert not list(tmp_path.glob("blocks/*/*.block"))
    assert store.assets().items == []


def test_a_flipped_bit_is_noticed(store, tmp_path):
    number = store.add_window("a", window(), finding())
    (block,) = tmp_path.glob("blocks/*/*.block")
    content = bytearray(block.read_bytes())
    content[-200] ^= 1
    block.write_bytes(content)
    with pytest.raises(BrokenBlock, match="checksum"):
        store.window_record("a", number)


def test_a_block_of_another_form_is_noticed(store, tmp_path):
    """Of a form that is not known nothing is believed, whatever its checksums say."""
    number = store.add_window("a", window(), finding())
    (block,) = tmp_path.glob("blocks/*/*.block")
    content = bytearray(block.read_bytes())
    content[content.index(b"\n") - 1] += 1
    block.write_bytes(content)
    with pytest.raises(BrokenBlock, match="is not a signal block"):
        store.window_record("a", number)


def test_only_blocks_without_a_row_are_swept(store, tmp_path):
    number = store.add_window("a", window(), finding())
    (block,) = tmp_path.glob("blocks/*/*.block")
    (block.parent / "left-by-a-crash.block").write_bytes(b"half")
    assert store.sweep() == 1
    assert store.window_record("a", number).n == 1000


def test_pages_hold_everything_once_while_more_arrives(store):
    for number in range(7):
        store.add_window("a", window(n=100 + number), finding())
    seen, cursor = [], None
    while True:
        page = store.findings("a", cursor, limit=3)
        seen += [item.window for item in page.items]
        store.add_window("a", window(), finding())
        if (cursor := page.next_cursor) is None:
            break
    assert len(seen) == len(set(seen)) == 7 and seen == sorted(seen, reverse=True)


def test_indicators_over_time_keep_gaps(store):
    store.add_window("a", window(), finding(indicators={"rms": 1.0}, thresholds={"rms": 2.0}))
    store.add_window("a", window(), finding("not-assessable"))
    store.add_window("a", window(), finding(indicators={"rms": 3.0, "new": 1.0}))
    history = store.indicators("a")
    assert history.indicators == {"rms": [1.0, None, 3.0], "new": [None, None, 1.0]}
    assert history.thresholds == {"rms": [2.0, None, None]}
    assert list(history.verdicts) == ["healthy", "not-assessable", "healthy"]


def test_an_alarm_lives_as_the_standard_says(store, announced):
    store.add_window("a", window(), finding("faulty"))
    (alarm,) = store.alarms().items
    assert (alarm.state, alarm.kind, alarm.condition) == (
        AlarmState.UNACKNOWLEDGED,
        "machine",
        True,
    )
    store.add_window("a", window(), finding("faulty"))
    assert store.alarm(alarm.id).occurrences == 1
    store.add_window("a", window(), finding("not-assessable"))
    assert store.alarm(alarm.id).state is AlarmState.UNACKNOWLEDGED
    store.add_window("a", window(), finding("healthy"))
    assert store.alarm(alarm.id).state is AlarmState.RETURNED_UNACKNOWLEDGED
    assert (
        store.operate_alarm(alarm.id, AlarmEvent.ACKNOWLEDGE, "eva", "seen").state
        is AlarmState.NORMAL
    )
    with pytest.raises(IllegalTransition, match="cannot acknowledge in state 'normal'"):
        store.operate_alarm(alarm.id, AlarmEvent.ACKNOWLEDGE, "eva")
    store.add_window("a", window(), finding("faulty"))
    again = store.alarm(alarm.id)
    assert (again.occurrences, again.acknowledged_by, again.state) == (
        2,
        None,
        AlarmState.UNACKNOWLEDGED,
    )
    assert [entry.event for entry in store.alarm_journal(alarm.id)] == [
        "raise",
        "acknowledge",
        "clear",
        "raise",
    ]
    assert {payload["kind"] for kind, payload in announced if kind == "alarm"} == {
        "machine",
        "signal",
    }


def test_a_shelved_alarm_comes_back_by_itself(store):
    store.add_window("a", window(), finding("faulty"))
    (alarm,) = store.alarms().items
    store.operate_alarm(
        alarm.id, AlarmEvent.SHELVE, "eva", None, datetime.now(UTC) + timedelta(hours=1)
    )
    store.unshelve_expired()
    assert store.alarm(alarm.id).state is AlarmState.SHELVED
    store.operate_alarm(alarm.id, AlarmEvent.UNSHELVE)
    assert store.alarm(alarm.id).state is AlarmState.UNACKNOWLEDGED
    store.operate_alarm(
        alarm.id, AlarmEvent.SHELVE, "eva", None, datetime.now(UTC) - timedelta(seconds=1)
    )
    store.add_window("a", window(), finding("healthy"))
    store.unshelve_expired()
    assert store.alarm(alarm.id).state is AlarmState.NORMAL


def test_no_order_of_events_hides_a_standing_fault(store):
    rng = np.random.default_rng(1)
    small = Record({"y": [0.0, 1.0]}, {"y": "V"}, 1.0)
    operations = [AlarmEvent.ACKNOWLEDGE, AlarmEvent.SHELVE, AlarmEvent.UNSHELVE]
    for _ in range(60):
        store.add_window("a", small, finding(rng.choice(["healthy", "faulty", "not-assessable"])))
        for alarm in store.alarms(active=False).items:
            event = operations[rng.integers(3)]
            try:
                store.operate_alarm(
                    alarm.id, event, "x", None, datetime.now(UTC) + timedelta(minutes=1)
                )
            except IllegalTransition:
                continue
        for alarm in store.alarms(active=False).items:
            assert not alarm.condition or alarm.state in (*ACTIVE, AlarmState.SHELVED)


def test_models_grow_versions_of_one_kind(store):
    store.add_model_version("drive", "physical", b"one", "first", "eva")
    assert store.add_model_version("drive", "physical", b"two").number == 2
    store.add_model_version("plant", "identified", b"{}")
    with pytest.raises(Conflict, match="is a physical model"):
        store.add_model_version("drive", "identified", b"{}")
    assert [(each.model, each.number) for each in store.models().items] == [
        ("drive", 2),
        ("plant", 1),
    ]
    assert (store.model_content("drive"), store.model_content("drive", 1)) == (b"two", b"one")
    with pytest.raises(NotFound, match="no version 3"):
        store.model_content("drive", 3)


def test_migrations_lead_to_the_tables_of_the_code_and_back(url):
    database = Database(url)
    database.migrate()
    with database.read() as connection:
        assert compare_metadata(MigrationContext.configure(connection), metadata) == []
    database.migrate("base")
    with database.read() as connection:
        kept = {
            table for table in metadata.tables if connection.dialect.has_table(connection, table)
        }
    assert kept == set()
    database.migrate()
    database.close()


def test_a_database_that_cannot_be_is_refused_in_one_line(tmp_path):
    with pytest.raises(BadSettings, match="nonsense"):
        DiskStore(tmp_path, "nonsense://host/db")
    with pytest.raises(StorageUnavailable, match="unable to open database"):
        DiskStore(tmp_path, "sqlite:////proc/no-such-folder/x.db".replace("no-such-folder/", ""))


WRITER = """
import sys
from pathlib import Path
import numpy as np
from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.storage import DiskStore

store = DiskStore(Path(sys.argv[1]), sys.argv[2])
for number in range(10_000):
    record = Record({"y": np.full(2000, float(number))}, {"y": "V"}, 1e-3)
    print(number, store.add_window("a", record, Finding("bearing", "healthy"), f"{sys.argv[3]}-{number}", "d"), flush=True)
"""


@pytest.mark.parametrize("after", [1, 23])
def test_a_killed_service_loses_nothing_that_it_acknowledged(tmp_path, url, after):
    command = [sys.executable, "-c", WRITER, str(tmp_path), url, str(after)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as writer:
        acknowledged = [tuple(map(int, writer.stdout.readline().split())) for _ in range(after)]
        writer.kill()
        acknowledged += [
            tuple(map(int, line.split())) for line in writer.stdout if line.endswith("\n")
        ]
    store = DiskStore(tmp_path, url)
    for number, stored in acknowledged:
        assert store.window_with_key("a", f"{after}-{number}", "d") == stored
        np.testing.assert_array_equal(store.window_record("a", stored)["y"], float(number))
    store.sweep()
    stored, cursor = 0, None
    while True:
        page = store.windows("a", cursor, limit=500)
        stored += len(page.items)
        if (cursor := page.next_cursor) is None:
            break
    assert len(acknowledged) <= stored <= len(acknowledged) + 1
    assert len(list(tmp_path.glob("blocks/*/*.block"))) == stored
    store.close()


def test_a_value_that_the_database_cannot_keep_is_bad_input(store, url):
    for name in ("a\0b", "n" * 201):
        if url.startswith("sqlite"):  # it keeps any text
            assert store.record(store.add_record(name, window())).name == name
            continue
        with pytest.raises(BadInput, match="cannot keep"):
            store.add_record(name, window())
