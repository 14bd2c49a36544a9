"""A flood of alarms is told when it begins and when it is over, and nothing of it is lost."""

import json
import time
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.alarms.alarm_states import AlarmEvent, AlarmRule
from residuum.service.notifications import Receiver
from residuum.service.storage import DiskStore

BEGIN = datetime(2026, 3, 1, tzinfo=UTC)
RECORD = Record({"y": np.zeros(4)}, {"y": "V"}, 1.0)


@pytest.fixture
def plant(tmp_path, monkeypatch):
    """The store and a machine's window at a second: (store, see)."""
    rules = {"each": AlarmRule()}
    store = DiskStore(
        tmp_path,
        f"sqlite:///{tmp_path / 'residuum.db'}",
        rule_of=lambda asset: rules.get(asset, AlarmRule(flood=10)),
    )

    def clock(second):
        at = BEGIN + timedelta(seconds=second)
        monkeypatch.setattr("residuum.service.storage.disk_store._now", lambda: at)

    def see(asset, verdict, second):
        clock(second)
        store.add_window(asset, RECORD, Finding("bearing", verdict, reason="-"))

    def tick(second):
        clock(second)
        store.unshelve_expired()

    yield store, see, tick
    store.close()


def told(store, receiver):
    notices = []
    while (notice := store.outbox.next(receiver)) is not None:
        notices.append(notice.alarm)
        store.outbox.told(receiver, notice)
    return notices


def test_a_flood_is_told_as_one_and_its_end_tells_all_that_changed(plant):
    store, see, tick = plant
    receiver = store.outbox.register("http://there")
    for number in range(25):
        see(f"machine-{number:02d}", "faulty", number)
    see("machine-03", "healthy", 40)
    see("each", "faulty", 41)
    notices = told(store, receiver)
    assert [notice["kind"] for notice in notices] == ["machine"] * 10 + ["flood", "machine"]
    begins = notices[10]
    assert (begins["phase"], begins["raised"], len(begins["alarms"])) == ("begins", 11, 11)
    assert notices[11]["asset"] == "each", "a rule without floods tells each change"
    tick(300)
    assert told(store, receiver) == [], "it goes on"
    tick(700)
    (ends,) = told(store, receiver)
    assert (ends["phase"], ends["raised"], ends["flood"]) == ("ends", 25, begins["flood"])
    states = {alarm["asset"]: alarm["state"] for alarm in ends["alarms"]}
    assert len(states) == 26 and states["machine-03"] == "returned-unacknowledged"
    assert set(states.values()) == {"unacknowledged", "returned-unacknowledged"}
    see("machine-03", "faulty", 710)
    assert [notice["kind"] for notice in told(store, receiver)] == ["machine"]
    actions = [entry.action for entry in store.audit(limit=500).items]
    assert actions.count("alarm flood begins") == actions.count("alarm flood ends") == 1


def test_ten_in_ten_minutes_are_none(plant):
    store, see, tick = plant
    receiver = store.outbox.register("http://there")
    for number in range(30):
        see(f"machine-{number:02d}", "faulty", 61 * number)
        tick(61 * number)
    assert [notice["kind"] for notice in told(store, receiver)] == ["machine"] * 30


def test_what_an_operator_does_in_a_flood_is_told_at_once(plant):
    store, see, _ = plant
    for number in range(12):
        see(f"machine-{number:02d}", "faulty", number)
    receiver = store.outbox.register("http://there")
    store.operate_alarm(1, AlarmEvent.ACKNOWLEDGE, "eva")
    (notice,) = told(store, receiver)
    assert (notice["asset"], notice["state"]) == ("machine-00", "acknowledged")


def test_receivers_get_a_flood_under_its_own_name(plant):
    store, see, _ = plant
    sent = []
    receiver = Receiver("there", "http://there", lambda *news: sent.append(news), findings=False)
    store.outbox.register("http://there")
    for number in range(12):
        see(f"machine-{number:02d}", "faulty", number)
    receiver.start(store.outbox)
    for _ in range(600):
        if len(sent) == 11:
            break
        time.sleep(0.05)
    receiver.stop()
    kinds = [kind for kind, _ in sent]
    assert kinds == ["alarm"] * 10 + ["flood"] and json.dumps(sent[-1][1])
