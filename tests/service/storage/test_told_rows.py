"""What people tell of findings, priorities and floods in either database: kept, sealed, and damage is told."""

from datetime import UTC, datetime

import numpy as np
import pytest
from sqlalchemy import text

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.alarms.alarm_states import AlarmRule
from residuum.service.machines.baselines import healthy_windows
from residuum.service.storage import DiskStore
from residuum.service.storage.database import Database
from residuum.service.storage.retention import Retention
from residuum.service.storage.rows import row_checks
from residuum.service.storage.tables import alarms
from residuum.service.store import FoundAtMachine, Outcome, StorageUnavailable

RECORD = Record({"speed": np.zeros(4)}, {"speed": "rpm"}, 1.0)
STANDS = {"signal": "speed", "unit": "rpm", "below": 60}


@pytest.fixture
def store(tmp_path, url):
    rules = {"stands": AlarmRule(suppress=[STANDS])}
    plain = AlarmRule(flood=2, consequence="major", time_to_respond=60)
    store = DiskStore(tmp_path, url, rule_of=lambda asset: rules.get(asset, plain))
    for asset in ("press", "fan", "pump", "stands"):
        store.add_window(asset, RECORD, Finding("bearing", "faulty", "ball", reason="-"))
    yield store
    store.close()


def damage(url, statement):
    database = Database(url)
    with database.write() as connection:
        connection.execute(text(statement))
    with database.read() as connection:
        wrong = row_checks.check_rows(connection).wrong
    database.close()
    return wrong


def test_either_database_keeps_what_was_told_and_tells_of_damage(store, url):
    store.confirm("press", 1, FoundAtMachine(Outcome.CONFIRMED, part="6204"), "eva")
    store.confirm("fan", 2, FoundAtMachine(Outcome.REFUTED, healthy=True), "eva")
    store.confirm("press", 1, FoundAtMachine(Outcome.CORRECTED, cause="crack"), "eva")
    assert [each.outcome for each in store.confirmations().items] == [
        "corrected",
        "refuted",
        "confirmed",
    ]
    span = (None, datetime(2999, 1, 1, tzinfo=UTC))
    standing = store.standing_confirmations(span)
    assert [(each.asset, each.outcome, each.said) for each in standing] == [
        ("fan", "refuted", "ball"),
        ("press", "corrected", "ball"),
    ]
    assert store.standing_confirmations(asset="fan", sites={"press"}) == []
    told = {alarm.asset: (alarm.state.value, alarm.priority) for alarm in store.alarms().items}
    assert told == {
        "press": ("unacknowledged", "high"),
        "fan": ("unacknowledged", "high"),
        "pump": ("unacknowledged", "high"),
        "stands": ("suppressed", None),
    }
    assert "alarm flood begins" in [entry.action for entry in store.audit().items]
    wrong = damage(url, "UPDATE confirmations SET outcome = 'confirmed' WHERE id = 3")
    assert wrong == ["confirmation 3 of 'press': its row differs from its checksum"]
    assert store.findings("press").items[0].confirmation.outcome == "damaged"
    assert store.findings("fan").items[0].confirmation.outcome == "refuted"
    with pytest.raises(StorageUnavailable, match="confirmation 3"):
        store.standing_confirmations()
    with pytest.raises(StorageUnavailable, match="confirmation 3"):
        healthy_windows(store, "press")
    wrong = damage(url, "UPDATE alarms SET priority = 'low' WHERE id = 1")
    assert "alarm 1 of 'press': its row differs from its checksum" in wrong


def test_what_was_told_outlives_the_findings(store):
    for number in range(4):
        store.add_window("press", RECORD, Finding("bearing", "healthy", reason=f"{number}"))
    store.confirm("press", 5, FoundAtMachine(Outcome.CONFIRMED))
    store.retain(Retention(np.inf, 0, np.inf, 1))
    assert 5 not in [each.id for each in store.findings("press").items], "its row was let go"
    (told,) = store.standing_confirmations()
    assert (told.said, told.outcome, told.finding) == ("healthy", "confirmed", 5)


def test_a_row_that_was_sealed_before_there_were_priorities_is_whole():
    old = {"asset_id": "press", "kind": "machine", "state": "normal", "condition": False}
    sealed = row_checks.of_row(alarms, old)
    assert sealed == row_checks.of_row(alarms, old | {"priority": None, "suppressed_by": None})
    changed = {
        row_checks.of_row(alarms, old | {name: "low"}) for name in ("priority", "suppressed_by")
    }
    assert len(changed | {sealed}) == 3
