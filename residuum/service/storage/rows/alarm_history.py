"""What alarms were raised in a span of time, and what became of each, out of their journal."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Sequence
from datetime import datetime
from typing import Any

from sqlalchemy import Connection, Row, Select, select

from residuum.service.alarms.alarm_states import AlarmEvent
from residuum.service.storage.rows import paging, row_checks
from residuum.service.storage.tables import alarm_journal, alarms, findings
from residuum.service.store import AlarmOccurrence, Page

# Entries of the journal that tell of an alarm, or may have done before they were damaged.
_RAISED = (alarm_journal.c.event == AlarmEvent.RAISE.value) | alarm_journal.c.event.not_in(
    [event.value for event in AlarmEvent]
)


def page(
    connection: Connection,
    span: tuple[datetime | None, datetime | None] = (None, None),
    asset: str | None = None,
    cursor: str | None = None,
    limit: int = 100,
    sites: Collection[str] | None = None,
    kind: str | None = None,
    priority: str | None = None,
) -> Page[AlarmOccurrence]:
    """Alarms that were raised in [begin, end), None for an open end, the newest first.

    `priority` is the one that the alarm had when it was raised last.
    """
    begin, end = span
    query: Select[Any] = (
        select(alarm_journal, alarms.c.asset_id, alarms.c.kind, alarms.c.priority)
        .join_from(alarm_journal, alarms)
        .where(_RAISED, paging.of_sites(alarms.c.asset_id, sites))
        .order_by(alarm_journal.c.id.desc())
        .limit(limit + 1)
    )
    for column, wanted in (
        (alarms.c.asset_id, asset),
        (alarms.c.kind, kind),
        (alarms.c.priority, priority),
    ):
        if wanted is not None:
            query = query.where(column == wanted)
    if begin is not None:
        query = query.where(alarm_journal.c.at >= begin)
    if end is not None:
        query = query.where(alarm_journal.c.at < end)
    if cursor:
        query = query.where(alarm_journal.c.id < paging.decode_number(cursor))
    raised = connection.execute(query).all()
    followed, causes = _what_followed(connection, raised), _findings_that_raised(connection, raised)
    return paging.page(
        raised,
        limit,
        "id",
        lambda row: _occurrence(row, followed[row.id], causes.get((row.asset_id, row.at))),
    )


def _what_followed(connection: Connection, raised: Sequence[Row[Any]]) -> dict[int, list[Row[Any]]]:
    """By the entry that raised an alarm, the entries of it until it was raised again."""
    followed: dict[int, list[Row[Any]]] = defaultdict(list)
    if not raised:
        return followed
    alarm_ids = {row.alarm_id for row in raised}
    # the oldest of the page: what came before it belongs to an earlier occurrence
    since = alarm_journal.c.id >= raised[-1].id
    entries = (
        select(alarm_journal)
        .where(alarm_journal.c.alarm_id.in_(alarm_ids), since)
        .order_by(alarm_journal.c.id)
    )
    last: dict[int, int] = {}
    for entry in connection.execute(entries):
        if entry.event == AlarmEvent.RAISE.value:
            last[entry.alarm_id] = entry.id
        # an entry before the first raise of the page ends an occurrence that is not on it
        elif entry.alarm_id in last:
            followed[last[entry.alarm_id]].append(entry)
    return followed


def _findings_that_raised(
    connection: Connection, raised: Sequence[Row[Any]]
) -> dict[tuple[str, datetime], Row[Any]]:
    """By asset and moment: a change of an alarm by a finding has its finding's moment."""
    if not raised:
        return {}
    c = findings.c
    where = c.asset_id.in_({row.asset_id for row in raised}) & c.at.in_({row.at for row in raised})
    columns: tuple[Any, ...] = (
        *(c[name] for name in row_checks.SHORT_OF_FINDING),
        c.reason,
        c.checksum,
    )
    return {
        (row.asset_id, row.at): row for row in connection.execute(select(*columns).where(where))
    }


def _occurrence(
    row: Row[Any], entries: Sequence[Row[Any]], cause: Row[Any] | None
) -> AlarmOccurrence:
    damaged = any(row_checks.differs(alarm_journal, entry._mapping) for entry in (row, *entries))
    cleared = _first(entries, AlarmEvent.CLEAR)
    acknowledged = _first(entries, AlarmEvent.ACKNOWLEDGE)
    message = None if cause is None else _says(cause)
    if damaged:
        message = f"alarm {row.alarm_id}, its journal: {row_checks.TELLS}"
    return AlarmOccurrence(
        id=row.id,
        alarm=row.alarm_id,
        asset=row.asset_id,
        kind=row.kind,
        raised_at=row.at,
        cleared_at=None if cleared is None else cleared.at,
        acknowledged_at=None if acknowledged is None else acknowledged.at,
        acknowledged_by=None if acknowledged is None else acknowledged.by,
        comments=[entry.comment for entry in entries if entry.comment],
        message=message,
        times_threshold=None if cause is None else _times_threshold(cause),
        window=None if cause is None else cause.window_id,
        priority=row.priority,
    )


def _first(entries: Sequence[Row[Any]], event: AlarmEvent) -> Row[Any] | None:
    return next((entry for entry in entries if entry.event == event.value), None)


def _says(cause: Row[Any]) -> str:
    if row_checks.differs(findings, cause._mapping):
        return f"its finding: {row_checks.TELLS}"
    return str(cause.reason or f"{cause.diagnoser}: {cause.fault_class or cause.verdict}")


def _times_threshold(cause: Row[Any]) -> float | None:
    """How far the indicator that is furthest above its threshold lies above it; None where none has
    a threshold, or the finding is damaged.
    """
    if row_checks.differs(findings, cause._mapping):
        return None
    limits = {
        name: limit for name, limit in cause.thresholds.items() if limit is not None and limit > 0
    }
    return max(
        (cause.indicators[n] / limits[n] for n in limits if cause.indicators.get(n) is not None),
        default=None,
    )
