"""An alarm's text is that of the worst finding since it was raised, also for a service that was started again."""

import re

import pytest

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.storage import DiskStore

RECORD = Record({"y": [1.0, 2.0, 3.0]}, {"y": "m/s²"}, 1e-3)


def faulty(size, says):
    return Finding(
        "bearing", "faulty", "ball", {"rms": size, "beside": 99.0}, {"rms": 1.0}, reason=says
    )


@pytest.fixture
def open_store(tmp_path):
    opened = []

    def open_again():
        for store, _ in opened:
            store.close()
        told = []
        store = DiskStore(
            tmp_path,
            f"sqlite:///{tmp_path / 'residuum.db'}",
            lambda kind, payload: told.append((kind, payload)),
        )
        opened.append((store, told))
        return store, told

    yield open_again
    opened[-1][0].close()


def test_the_text_follows_the_worst_window_and_says_since_when(open_store):
    store, told = open_store()
    first = store.add_window("press", RECORD, faulty(1.2, "half of the window is faulty"))
    store.add_window("press", RECORD, faulty(1.1, "a little less"))
    (alarm,) = store.alarms().items
    assert (
        alarm.message.startswith("half of the window is faulty; since ") and alarm.window == first
    )
    store, told = open_store()
    worst = store.add_window("press", RECORD, faulty(5.0, "all of it is faulty"))
    store.add_window("press", RECORD, faulty(2.0, "less again"))
    (alarm,) = store.alarms().items
    assert re.fullmatch(r"all of it is faulty; since .* UTC, at its worst .* UTC", alarm.message)
    assert (alarm.window, alarm.occurrences) == (worst, 1) and alarm.worst_at > alarm.raised_at
    changes = [payload for kind, payload in told if kind == "alarm"]
    assert [(change["message"], change["text_alone"]) for change in changes] == [
        (alarm.message, True)
    ]
    assert len(store.alarm_journal(alarm.id)) == 1, "a text is no change of state"


def test_an_alarm_that_is_raised_again_begins_anew(open_store):
    store, _ = open_store()
    store.add_window("press", RECORD, faulty(5.0, "very bad"))
    store.add_window(
        "press",
        RECORD,
        Finding("bearing", "healthy", indicators={"rms": 0.1}, thresholds={"rms": 1.0}, reason="-"),
    )
    again = store.add_window("press", RECORD, faulty(1.2, "a little"))
    (alarm,) = store.alarms().items
    assert alarm.message.startswith("a little; since ") and alarm.window == again


def test_metrics_count_changes_of_state_alone(run_service):
    service = run_service()
    store = service.services.store
    store.add_window("press", RECORD, faulty(1.2, "half"))
    store.add_window("press", RECORD, faulty(5.0, "all"))
    assert (
        'residuum_alarm_changes_total{asset="press",state="unacknowledged"} 1.0'
        in service.services.metrics.render().decode()
    )
