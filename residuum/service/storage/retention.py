"""What may go: first the signals of the oldest windows beyond an age or an amount, then their rows, unless somebody may still
ask for them.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, Select, delete, func, select, update

from residuum.service.alarms.alarm_states import AlarmState
from residuum.service.storage.rows import finding_hours, finding_notices
from residuum.service.storage.tables import alarms, assets, findings, windows

_DAY = 86_400.0
_AT_ONCE = 500
"""Signals let go in one transaction, so that writers never wait long for it."""


@dataclass(frozen=True)
class Retention:
    """How long, and how many bytes of, the windows' signals are kept; and how long, and how many of, their rows."""

    days: float
    size_bytes: int
    row_days: float = math.inf
    rows: int = sys.maxsize


def let_go(connection: Connection, retention: Retention, now: datetime) -> list[str]:
    """Write down that the oldest signals beyond the age or the amount are gone, a batch at most; returns their blocks' paths.

    Signals of rows that are to go go too. Kept whatever their age: the newest window of every asset, and the window behind every
    alarm that is not normal.
    """
    held = connection.execute(select(func.coalesce(func.sum(windows.c.size_bytes), 0)).where(_HELD)).scalar_one()
    surplus = int(held) - retention.size_bytes
    rows = connection.execute(select(func.count()).select_from(windows).where(_HELD)).scalar_one() - retention.rows
    days = min(retention.days, retention.row_days)
    gone: list[Row[Any]] = []
    for row in connection.execute(_may_go(_HELD)):
        if surplus <= 0 and rows <= 0 and (now - row.received_at).total_seconds() <= days * _DAY:
            break
        surplus -= row.size_bytes
        rows -= 1
        gone.append(row)
    ids = [row.id for row in gone]
    connection.execute(update(windows).where(windows.c.id.in_(ids)).values(signal_let_go_at=now))
    return [row.block_path for row in gone]


def forget(connection: Connection, retention: Retention, now: datetime) -> int:
    """Fold the findings of the oldest windows beyond the age or the number into their hours, and delete the rows of both.

    A batch at most; returns how many. Only windows whose signal is gone; kept is what `let_go` keeps, and what any alarm names.
    """
    surplus = connection.execute(select(func.count()).select_from(windows)).scalar_one() - retention.rows
    gone: list[int] = []
    for row in connection.execute(_may_go(windows.c.signal_let_go_at.is_not(None), alarming=alarms.c.window_id.is_not(None))):
        if len(gone) >= surplus and (now - row.received_at).total_seconds() <= retention.row_days * _DAY:
            break
        gone.append(row.id)
    if gone:
        theirs = findings.c.window_id.in_(gone)
        finding_notices.forget(connection, theirs)
        finding_hours.add(connection, connection.execute(select(findings).where(theirs).order_by(findings.c.id)).all())
        connection.execute(delete(findings).where(theirs))
        connection.execute(delete(windows).where(windows.c.id.in_(gone)))
    return len(gone)


_HELD = windows.c.signal_let_go_at.is_(None)
_ALARMING = (alarms.c.state != AlarmState.NORMAL.value) & alarms.c.window_id.is_not(None)


def _may_go(which: ColumnElement[bool], alarming: ColumnElement[bool] = _ALARMING) -> Select[Any]:
    newest = select(func.max(windows.c.id)).where(windows.c.asset_id == assets.c.id).correlate(assets).scalar_subquery()
    query = select(windows.c.id, windows.c.block_path, windows.c.size_bytes, windows.c.received_at).where(
        which,
        windows.c.id.not_in(select(newest).select_from(assets).where(newest.is_not(None))),
        windows.c.id.not_in(select(alarms.c.window_id).where(alarming)),
    )
    return query.order_by(windows.c.id).limit(_AT_ONCE)
