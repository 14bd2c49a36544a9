"""Floods, chatter and stale alarms are counted as they were made."""

from datetime import UTC, datetime, timedelta

import pytest

from residuum.diagnosis.finding import Finding
from residuum.service.alarms.alarm_states import AlarmRule
from residuum.service.storage import retention
from residuum.service.storage.database import Database
from residuum.service.storage.rows import alarms, assets, row_checks
from residuum.service.storage.tables import alarms as rows

PLAIN = AlarmRule()
NOW = datetime(2026, 6, 1, 12, tzinfo=UTC)


@pytest.fixture
def database(tmp_path):
    database = Database(f"sqlite:///{tmp_path / 'residuum.db'}")
    database.migrate()
    yield database
    database.close()


def follow(connection, asset, finding, now=NOW, rule=PLAIN):
    window = alarms.JudgedWindow(None, finding, rule, now, seen_at=now)
    return alarms.follow(connection, asset, window)


def see(connection, asset, verdict, seconds_ago, rule=PLAIN):
    now = NOW - timedelta(seconds=seconds_ago)
    assets.ensure(connection, asset, None, "bearing", now)
    followed = follow(connection, asset, Finding("bearing", verdict, reason="-"), now, rule)
    return [change.alarm for change in followed]


def test_a_flood_a_chattering_and_a_stale_alarm(database):
    with database.write() as connection:
        for number in range(12):
            see(connection, f"machine-{number:02d}", "faulty", 300 + number)
        see(connection, "old", "faulty", 100_000)
        for second in range(0, 40, 10):
            see(connection, "chatter", "faulty", 7000 - second)
            see(connection, "chatter", "healthy", 7000 - second - 5)
        found = retention.rates(connection, NOW)
        assert (found.last_10_minutes, found.last_hour, found.last_day) == (12, 12, 16)
        assert (found.flood, found.highest_in_10_minutes) == (True, 12)
        assert found.flood_share == pytest.approx(1 / 144)
        assert found.most_frequent[0] == {
            "alarm": 14,
            "asset": "chatter",
            "kind": "machine",
            "raised": 4,
        }
        assert (found.chattering, found.stale) == ([14], [13])
        assert found.standing == {"unacknowledged": 13, "returned-unacknowledged": 1}


def test_a_quiet_plant(database):
    with database.read() as connection:
        found = retention.rates(connection, NOW)
    assert (found.last_day, found.highest_in_10_minutes, found.flood, found.flood_share) == (
        0,
        0,
        False,
        0.0,
    )


def test_delays_deadband_and_latch_hold_for_stored_alarms(database):
    rule = AlarmRule(on_delay=10, off_delay=30, latch=True)
    with database.write() as connection:
        assert see(connection, "a", "faulty", 1000, rule) == []
        assert see(connection, "a", "faulty", 995, rule) == []
        (raised,) = see(connection, "a", "faulty", 990, rule)
        assert (raised.state, raised.occurrences) == ("unacknowledged", 1)
        assert see(connection, "a", "healthy", 985, rule) == []
        (cleared,) = see(connection, "a", "healthy", 955, rule)
        assert (cleared.state, cleared.condition) == ("unacknowledged", False)
        row_checks.change(connection, rows, raised.id, lambda _row: {"condition": True})
        near = Finding(
            "bearing", "healthy", indicators={"rms": 0.95}, thresholds={"rms": 1.0}, reason="-"
        )
        assert follow(connection, "a", near, rule=AlarmRule(deadband=0.1)) == []
        assert len(follow(connection, "a", near)) == 1


def test_limits_that_hold_again_clear_the_alarm_of_a_machine_without_baseline(database):
    calm = Finding(
        "bearing", "healthy", indicators={"kurtosis": 3.0}, thresholds={"kurtosis": 6.0}
    ).without_baseline("kurtosis")
    with database.write() as connection:
        see(connection, "a", "faulty", 100)
        (cleared,) = follow(connection, "a", calm)
        assert (cleared.alarm.kind, cleared.alarm.condition) == ("machine", False)
