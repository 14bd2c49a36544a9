"""A clock that jumps deletes nothing at once: age counts only as far as the clock can be believed."""

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.storage import DiskStore
from residuum.service.storage.retention import Retention

NOW = datetime(2026, 5, 1, 12, 0, tzinfo=UTC)
RULE = Retention(30.0, 2**40, 365.0, 10**6)


@pytest.fixture
def store(tmp_path):
    store = DiskStore(tmp_path, f"sqlite:///{tmp_path / 'store.db'}")
    yield store
    store.close()


@pytest.fixture
def clock(monkeypatch):
    """Sets the clock, and with `hours` how long the service has run by the clock that nobody sets."""

    def set_to(moment, hours=0.0):
        monkeypatch.setattr("residuum.service.storage.disk_store._now", lambda: moment)
        monkeypatch.setattr("residuum.service.storage.retention.monotonic", lambda: 3600.0 * hours)

    return set_to


def add(store, count=1):
    for _ in range(count):
        store.add_window(
            "a",
            Record({"y": np.arange(10.0)}, {"y": "V"}, 1e-3),
            Finding("bearing", "healthy", reason="-"),
        )


def kept(store):
    return sum(window.signal_let_go_at is None for window in store.windows("a", limit=1000).items)


def test_two_years_ahead_nothing_goes_and_somebody_is_told(store, clock):
    clock(NOW)
    add(store, 20)
    clock(NOW + timedelta(days=730))
    assert store.retain(RULE) == 0 and kept(store) == 20
    assert "clock says 2028-04-30" in store.troubles()["retention"]
    clock(NOW)
    assert store.retain(RULE) == 0 and store.troubles() == {}


def test_with_new_windows_at_the_wrong_time_a_bounded_share_goes_a_day(store, clock):
    clock(NOW)
    add(store, 150)
    ahead = NOW + timedelta(days=730)
    for day, left in ((0, 135), (0, 136), (1, 123)):
        clock(ahead + timedelta(days=1.1 * day), hours=26.4 * day)
        add(store)
        store.retain(RULE)
        assert kept(store) == left, day
        assert "older than 30 days than the 10 %" in store.troubles()["retention"]
    assert len(store.windows("a", limit=1000).items) > 120, "rows go no faster"


def test_a_steady_plant_is_not_held_back(store, clock):
    rule = Retention(3.0, 2**40, 5.0, 10**6)
    for hour in range(0, 24 * 12, 4):
        clock(NOW + timedelta(hours=hour), hours=hour)
        add(store)
        store.retain(rule)
        assert store.troubles() == {}, hour
    assert kept(store) == 3 * 6 + 1


def test_the_amount_needs_no_clock(store, clock):
    clock(NOW)
    add(store, 20)
    clock(NOW + timedelta(days=730))
    assert store.retain(Retention(30.0, 0)) == 19
