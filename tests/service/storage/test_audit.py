"""The audit trail: any edit, deletion, insertion or reordering of what was written is noticed."""

import random
from datetime import UTC, datetime, timedelta

import pytest
from sqlalchemy import delete, insert, select, update

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.alarms.alarm_states import AlarmEvent
from residuum.service.cli import run
from residuum.service.storage import DiskStore, audit
from residuum.service.storage.audit import BrokenAudit
from residuum.service.storage.database import Database
from residuum.service.storage.tables import audit as trail
from residuum.service.storage.tables import audit_head

START = datetime(2026, 1, 1, tzinfo=UTC)
ENTRIES = 60


@pytest.fixture
def database(tmp_path):
    database = Database(f"sqlite:///{tmp_path / 'residuum.db'}")
    database.migrate()
    with database.write() as connection:
        for number in range(ENTRIES):
            detail = {"comment": f"comment {number}", "state": "normal"}
            moment = START + timedelta(seconds=number)
            audit.append(
                connection,
                "alarm acknowledge",
                f"alarm {number % 7}",
                by=f"user {number % 3}",
                now=moment,
                detail=detail,
            )
    yield database
    database.close()


def edit(connection, rng):
    """One change that a person with the database at hand could make; False when it changed nothing."""
    row = rng.choice(connection.execute(select(trail)).all())
    here = trail.c.number == row.number
    kind = rng.randrange(7)
    if kind == 0:
        first = rng.randrange(1, ENTRIES + 1)
        connection.execute(
            delete(trail).where(
                trail.c.number.between(first, first + rng.choice((0, 0, 3, ENTRIES)))
            )
        )
    elif kind == 1:
        connection.execute(
            update(trail)
            .where(here)
            .values(at=row.at + timedelta(microseconds=rng.choice((1, -1, 10**6))))
        )
    elif kind == 2:
        column = rng.choice(("by", "action", "subject", "detail", "digest"))
        text = getattr(row, column)
        at = rng.randrange(len(text))
        changed = rng.choice(
            (
                text[:at] + chr(ord(text[at]) ^ 1) + text[at + 1 :],
                text[:at] + text[at + 1 :],
                text + " ",
                "",
            )
        )
        connection.execute(update(trail).where(here).values({column: changed}))
    elif kind == 3:
        connection.execute(update(trail).where(here).values(by=None))
    elif kind == 4:
        other = rng.choice([each for each in range(1, ENTRIES + 1) if each != row.number])
        for number, moved in ((row.number, -1), (other, row.number), (-1, other)):
            connection.execute(update(trail).where(trail.c.number == number).values(number=moved))
    elif kind == 5:
        added = row._asdict() | {"number": ENTRIES + 1}
        connection.execute(insert(trail).values(added))
    else:
        values = rng.choice(
            ({"entries": ENTRIES - 1}, {"digest": "f" * 64}, {"entries": 0, "digest": "0" * 64})
        )
        connection.execute(update(audit_head).values(values))


def test_a_thousand_random_edits_and_deletions_are_all_noticed(database):
    rng = random.Random(11)
    with database.read() as connection:
        whole = audit.verify(connection)
    assert whole.entries == ENTRIES
    for trial in range(1000):
        with database.engine.connect() as connection:
            edit(connection, rng)
            with pytest.raises(BrokenAudit, match="audit: "):
                pytest.fail(f"trial {trial}: not noticed: {audit.verify(connection)}")
            connection.rollback()
    with database.read() as connection:
        assert audit.verify(connection) == whole


@pytest.mark.parametrize(
    "change",
    ["at = 'yesterday'", "at = 12", "\"by\" = x'00'", "detail = x'ff'", "number = 'seven'"],
)
def test_an_entry_that_is_none_any_more_is_noticed(database, change):
    with database.write() as connection:
        connection.exec_driver_sql("PRAGMA ignore_check_constraints = ON")
        connection.exec_driver_sql(f"UPDATE audit SET {change} WHERE number = 7")
    with database.read() as connection, pytest.raises(BrokenAudit, match="audit: "):
        audit.verify(connection)


def test_what_is_done_to_alarms_and_models_is_written_down_and_doctor_looks_at_it(tmp_path, capsys):
    store = DiskStore(tmp_path, f"sqlite:///{tmp_path / 'residuum.db'}")
    store.add_window(
        "press",
        Record({"y": [0.0, 1.0]}, {"y": "V"}, 1.0),
        Finding("bearing", "faulty", reason="-"),
    )
    store.operate_alarm(1, AlarmEvent.ACKNOWLEDGE, "eva", "seen")
    store.add_model_version("drive", "physical", b"one", by="udo")
    told = [(entry.number, entry.by, entry.action, entry.subject) for entry in store.audit().items]
    assert told == [
        (3, "udo", "model version", "model drive"),
        (2, "eva", "alarm acknowledge", "alarm 1"),
        (1, None, "alarm raise", "alarm 1"),
    ]
    assert store.audit(limit=2).next_cursor and store.audit().items[1].detail["comment"] == "seen"
    store.close()
    assert run(["doctor", "--data", str(tmp_path)]) == 0
    assert "audit trail     3 entries, none changed or missing" in capsys.readouterr().out
    database = Database(f"sqlite:///{tmp_path / 'residuum.db'}")
    with database.write() as connection:
        connection.execute(update(trail).where(trail.c.number == 2).values(by="udo"))
    database.close()
    assert run(["doctor", "--data", str(tmp_path)]) == 1
    assert "audit: entry 2 or the one before it was changed" in capsys.readouterr().out
