"""Floods of alarms (ANSI/ISA-18.2-2016, clause 16.5), told as one: when one begins, and when it is
over with all alarms as they are then.
"""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Any

from sqlalchemy import Connection, Row, func, insert, select

from residuum.service.alarms.alarm_states import AlarmEvent, AlarmState
from residuum.service.storage import audit, outbox
from residuum.service.storage.rows import row_checks
from residuum.service.storage.tables import alarm_floods, alarm_journal, alarms

FLOOD = "flood"
"""What a notice of a flood has as its `kind`."""
# The span in which a flood's alarms are counted (ANSI/ISA-18.2-2016, 16.5).
_WITHIN = timedelta(minutes=10)
# Share of the number that begins a flood below which it is over.
_OVER = 0.5


def takes(connection: Connection, event: AlarmEvent, more_than: int, now: datetime) -> bool:
    """Whether a change by a machine is told with a flood, instead of by itself; the change that is
    one too many begins the flood.

    Parameters
    ----------
    more_than : int
        Alarms in ten minutes that are no flood yet; 0: there are none.
    """
    if more_than == 0:
        return False
    standing = _standing(connection)
    if standing is not None:
        more = int(event is AlarmEvent.RAISE)
        row_checks.change(
            connection, alarm_floods, standing.id, lambda row: {"raised": row["raised"] + more}
        )
        return True
    raised = _raised_since(connection, now - _WITHIN)
    if event is not AlarmEvent.RAISE or raised <= more_than:
        return False
    values = {"began_at": now, "ended_at": None, "more_than": more_than, "raised": raised}
    query = insert(alarm_floods).values(row_checks.sealed(alarm_floods, values))
    flood = connection.execute(query.returning(alarm_floods)).one()
    _tell(connection, flood, "begins", now)
    return True


def end(connection: Connection, now: datetime) -> None:
    """Tell that a flood is over, once half as many alarms as begin one were raised in ten
    minutes.
    """
    standing = _standing(connection)
    if standing is None:
        return
    if _raised_since(connection, now - _WITHIN) > _OVER * standing.more_than:
        return
    changes = {"ended_at": now}
    flood = row_checks.change(connection, alarm_floods, standing.id, lambda _row: changes)
    _tell(connection, flood, "ends", now)


def _standing(connection: Connection) -> Row[Any] | None:
    query = select(alarm_floods).where(alarm_floods.c.ended_at.is_(None)).with_for_update()
    return connection.execute(query.order_by(alarm_floods.c.id)).first()


def _raised_since(connection: Connection, begin: datetime) -> int:
    """Alarms that came onto the list since."""
    c = alarm_journal.c
    listed = (c.event == AlarmEvent.RAISE.value) & (c.state == AlarmState.UNACKNOWLEDGED.value)
    query = select(func.count()).select_from(alarm_journal).where(listed, c.at > begin)
    return connection.execute(query).scalar_one()


def _tell(connection: Connection, flood: Row[Any], phase: str, now: datetime) -> None:
    """A notice, with the alarms that changed since the flood began, or that were raised in the ten
    minutes before.
    """
    changed = select(alarm_journal.c.alarm_id).where(alarm_journal.c.at > flood.began_at - _WITHIN)
    query = select(alarms).where(alarms.c.id.in_(changed)).order_by(alarms.c.id)
    notice = {
        "kind": FLOOD,
        "phase": phase,
        "flood": flood.id,
        "began_at": flood.began_at,
        "ended_at": flood.ended_at,
        "raised": flood.raised,
        "alarms": [_short(row) for row in connection.execute(query)],
    }
    detail = {"raised": flood.raised, "began_at": flood.began_at}
    subject = f"flood {flood.id}"
    audit.append(connection, f"alarm flood {phase}", subject, by=None, now=now, detail=detail)
    outbox.add_notice(connection, notice)


def _short(row: Row[Any]) -> dict[str, Any]:
    """An alarm in a notice of a flood; of a damaged row only which one it is."""
    named = {"id": row.id, "asset": row.asset_id, "kind": row.kind}
    if row_checks.differs(alarms, row._mapping):
        return named | {"state": "damaged", "message": row_checks.TELLS}
    return named | {
        "state": row.state,
        "condition": row.condition,
        "priority": row.priority,
        "message": row.message,
    }
