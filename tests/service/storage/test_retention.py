"""Old signals go, what somebody may still ask for stays, and a window says what became of its signal."""

import os
import time
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.alarms.alarm_states import AlarmEvent
from residuum.service.storage import DiskStore
from residuum.service.storage.retention import Retention
from residuum.service.store import SignalLetGo

FOREVER = float("inf")


@pytest.fixture
def store(tmp_path):
    store = DiskStore(tmp_path, f"sqlite:///{tmp_path / 'store.db'}")
    yield store
    store.close()


def add(store, asset="a", verdict="healthy"):
    return store.add_window(
        asset,
        Record({"y": np.arange(1000.0)}, {"y": "V"}, 1e-3),
        Finding("bearing", verdict, reason="-"),
    )


def kept(store, asset="a"):
    return {window.id for window in store.windows(asset).items if window.signal_let_go_at is None}


def test_the_oldest_signals_go_until_the_amount_is_kept(store, tmp_path):
    numbers = [add(store) for _ in range(6)]
    size = store.window("a", numbers[0]).size_bytes
    assert store.retain(Retention(FOREVER, 3 * size)) == 3
    assert kept(store) == set(numbers[3:])
    assert sum(file.stat().st_size for file in tmp_path.glob("blocks/*/*.block")) == 3 * size
    assert store.retain(Retention(FOREVER, 3 * size)) == 0
    with pytest.raises(SignalLetGo, match=f"window {numbers[0]}: its signal was let go at"):
        store.window_record("a", numbers[0])
    assert store.finding_of(numbers[0]).window == numbers[0] and len(store.findings("a").items) == 6
    assert store.window_record("a", numbers[3]).n == 1000


def test_signals_beyond_the_age_go_whatever_their_amount(store, monkeypatch):
    monkeypatch.setattr(
        "residuum.service.storage.disk_store._now", lambda: datetime.now(UTC) - timedelta(days=3)
    )
    old = [add(store) for _ in range(3)]
    monkeypatch.undo()
    new = [add(store) for _ in range(2)]
    assert store.retain(Retention(3.1, 2**40)) == 0
    assert store.retain(Retention(2.9, 2**40)) == 3
    assert kept(store) == set(new) and not kept(store) & set(old)


def test_the_newest_window_of_an_asset_and_those_behind_open_alarms_stay(store):
    faulty = add(store, verdict="faulty")
    passed = add(store)
    unjudged = add(store, verdict="not-assessable")
    newest = add(store)
    other = add(store, asset="b")
    assert store.retain(Retention(FOREVER, 0)) == 1
    assert (
        kept(store) == {faulty, unjudged, newest}
        and kept(store, "b") == {other}
        and passed not in kept(store)
    )
    for alarm in store.alarms().items:
        store.operate_alarm(alarm.id, AlarmEvent.ACKNOWLEDGE)
    assert store.retain(Retention(FOREVER, 0)) == 2
    assert kept(store) == {newest}


def test_more_than_one_batch_goes_in_one_call(store, monkeypatch):
    monkeypatch.setattr("residuum.service.storage.retention._AT_ONCE", 2)
    for _ in range(6):
        add(store)
    assert store.retain(Retention(FOREVER, 0)) == 5


def test_a_crash_between_row_and_file_leaves_a_block_that_the_sweep_removes(
    store, monkeypatch, tmp_path
):
    for _ in range(3):
        add(store)
    monkeypatch.setattr(store._blocks, "remove", lambda path: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        store.retain(Retention(FOREVER, 0))
    monkeypatch.undo()
    assert len(kept(store)) == 1 and len(list(tmp_path.glob("blocks/*/*.block"))) == 3
    assert store.sweep() == 2
    assert store.window_record("a", *kept(store)).n == 1000


def test_the_sweep_leaves_blocks_that_may_still_get_their_row(store, tmp_path):
    add(store)
    (block,) = tmp_path.glob("blocks/*/*.block")
    fresh, stale = block.with_name("fresh.block"), block.with_name("stale.block")
    fresh.write_bytes(b"x")
    stale.write_bytes(b"x")
    os.utime(stale, (time.time() - 300,) * 2)
    assert store.sweep(settled=120) == 1
    assert fresh.exists() and block.exists() and not stale.exists()


def add_at(store, monkeypatch, hours_ago, verdict="healthy", rms=1.0):
    moment = datetime(2026, 5, 1, 12, 30, tzinfo=UTC) - timedelta(hours=hours_ago)
    monkeypatch.setattr("residuum.service.storage.disk_store._now", lambda: moment)
    record = Record({"y": np.arange(10.0)}, {"y": "V"}, 1e-3)
    finding = Finding(
        "bearing",
        verdict,
        indicators={"rms": rms},
        thresholds={"rms": 5.0},
        units={"rms": "V"},
        reason="-",
    )
    return store.add_window("a", record, finding)


def test_rows_beyond_the_number_become_hours_that_hold_all_of_them(store, monkeypatch):
    values = np.random.default_rng(2).uniform(0, 4, 40)
    numbers = [
        add_at(store, monkeypatch, 40 - k, rms=float(value)) for k, value in enumerate(values)
    ]
    rule = Retention(FOREVER, 2**40, FOREVER, 10)
    assert store.retain(rule) == 30
    assert [window.id for window in store.windows("a").items][::-1] == numbers[30:]
    assert len(store.findings("a").items) == 10 and store.asset("a").windows == 40
    hours = store.finding_hours("a")
    assert [hour.windows for hour in hours] == [1] * 30
    np.testing.assert_allclose([hour.indicators["rms"]["mean"] for hour in hours], values[:30])
    assert store.retain(rule) == 0


def test_the_audit_trail_tells_of_what_was_let_go(store, monkeypatch):
    for k in range(40):
        add_at(store, monkeypatch, 40 - k)
    monkeypatch.setattr("residuum.service.storage.retention._AT_ONCE", 8)
    store.retain(Retention(FOREVER, 2**40, FOREVER, 10))
    store.retain(Retention(FOREVER, 2**40, FOREVER, 10))
    told = [(entry.action, entry.by, entry.detail["windows"]) for entry in store.audit().items]
    for action in ("signals let go", "rows let go"):
        assert sum(windows for what, by, windows in told if (what, by) == (action, None)) == 30
    assert len(told) == 8  # four goes each, and nothing of a call after which nothing went


def test_one_hour_is_folded_in_several_goes_without_loss(store, monkeypatch):
    monkeypatch.setattr("residuum.service.storage.retention._AT_ONCE", 3)
    values = np.random.default_rng(3).uniform(0, 4, 20)
    for value in values:
        add_at(store, monkeypatch, 0.0, rms=float(value), verdict="healthy")
    add_at(store, monkeypatch, -1.0)
    store.retain(Retention(FOREVER, 2**40, FOREVER, 1))
    (hour,) = store.finding_hours("a")
    rms = hour.indicators["rms"]
    assert (hour.windows, dict(hour.verdicts), rms["n"], rms["unit"], rms["threshold"]) == (
        20,
        {"healthy": 20},
        20,
        "V",
        5.0,
    )
    assert (rms["minimum"], rms["maximum"]) == (values.min(), values.max())
    assert rms["mean"] == pytest.approx(values.mean())


def test_rows_that_an_alarm_names_stay_however_old(store, monkeypatch):
    faulty = add_at(store, monkeypatch, 1000, verdict="faulty")
    for hours in (900, 800, 2, 1):
        last = add_at(store, monkeypatch, hours)
    store.operate_alarm(1, AlarmEvent.ACKNOWLEDGE)
    assert store.alarm(1).state == "normal"
    store.retain(Retention(FOREVER, 2**40, 10.0, 100))
    assert [window.id for window in store.windows("a").items] == [last, last - 1, faulty]
    assert store.finding_of(faulty).finding.verdict == "faulty"
