"""Rows of alarms and of their journal. An asset has one alarm a kind: `machine` (a fault) and
`signal` (cannot be judged).
"""

from __future__ import annotations

import json
from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import Connection, Row, insert, select, update

from residuum.diagnosis.finding import Finding, Verdict
from residuum.service.alarms import alarm_states
from residuum.service.alarms.alarm_states import (
    ACTIVE,
    MACHINE,
    SIGNAL,
    AlarmEvent,
    AlarmRule,
    AlarmState,
    AlarmStatus,
    beyond,
    in_deadband,
    severity,
)
from residuum.service.storage import audit, outbox
from residuum.service.storage.rows import alarm_floods, paging, row_checks
from residuum.service.storage.tables import alarm_journal, alarms
from residuum.service.store import Alarm, AlarmEntry, NotFound, Page

_NEVER_RAISED = {
    "state": AlarmState.NORMAL.value,
    "condition": False,
    "message": "",
    "occurrences": 0,
}
_SHOWN: dict[Verdict, tuple[tuple[str, bool], ...]] = {
    Verdict.FAULTY: ((MACHINE, True), (SIGNAL, False)),
    Verdict.HEALTHY: ((MACHINE, False), (SIGNAL, False)),
    # A window that cannot be judged says nothing about the machine: its alarm stays as it is.
    Verdict.NOT_ASSESSABLE: ((SIGNAL, True),),
}


def follow(
    connection: Connection,
    asset: str,
    window: int,
    finding: Finding,
    now: datetime,
    rule: AlarmRule,
    seen_at: datetime | None = None,
    aside: str | None = "",
) -> list[Followed]:
    """Let an asset's alarms follow a finding; returns the alarms that changed their state, or their
    text with a worse finding.

    Parameters
    ----------
    seen_at : datetime or None
        The window's own time, by which delays count; None: now.
    aside : str or None
        The state of the machine that suppresses its alarms; empty for none, None where the window
        does not tell: then what is suppressed stays so, and nothing else becomes it.
    """
    if finding.only_recorded:
        return []
    stored = connection.execute(select(alarms).where(alarms.c.asset_id == asset)).all()
    rows = {row.kind: _begun_anew(connection, row, now) if _differs(row) else row for row in stored}
    seen = _Seen(window, finding, rule, seen_at or now, aside or "", now)
    changed = []
    if seen.aside:  # whatever the window says: most windows of a machine that stands tell nothing
        for kind in [kind for kind, row in rows.items() if row.state in _LISTED]:
            changed.append(_suppressed(connection, rows[kind], seen.aside, now))
            rows[kind] = _row(connection, rows[kind].id)
    for kind, faulty in _SHOWN[seen.verdict]:
        if faulty or kind in rows:
            row = rows.get(kind) or _new(connection, asset, kind)
            changed += _shown(connection, row, faulty, seen)
    if seen.verdict is Verdict.NOT_ASSESSABLE and MACHINE in rows:
        judged_at = alarm_states.unjudged(_status(rows[MACHINE])).judged_at
        _put(connection, rows[MACHINE].id, {"judged_at": judged_at})
    if aside == "" and any(row.suppressed_by for row in rows.values()):
        changed += _released(connection, asset, now)
    return changed


@dataclass(frozen=True)
class _Seen:
    """A window that alarms follow: its finding, its own time, and the state that puts them aside."""

    window: int
    finding: Finding
    rule: AlarmRule
    at: datetime
    aside: str
    now: datetime

    @property
    def verdict(self) -> Verdict:
        """Without a baseline an absolute limit raised the alarm: where all of them hold again,
        nothing keeps it.
        """
        within = self.finding.within_absolute_limits
        return Verdict.HEALTHY if within else self.finding.verdict

    def keeps(self, row: Row[Any]) -> bool:
        """Whether the machine's alarm stands because indicators are within the deadband yet."""
        # none stood above a threshold of its own: any counts
        raised_by = json.loads(row.raised_by or "[]") or None
        indicators, thresholds = self.finding.indicators, self.finding.thresholds
        standing = row.kind == MACHINE and row.condition
        return standing and in_deadband(self.rule, indicators, thresholds, raised_by)


def _shown(connection: Connection, row: Row[Any], faulty: bool, seen: _Seen) -> list[Followed]:
    """What becomes of one alarm."""
    changed = []
    if seen.aside and faulty and row.state == AlarmState.NORMAL.value:
        changed.append(_suppressed(connection, row, seen.aside, seen.now))
        row = _row(connection, row.id)
    condition = faulty or seen.keeps(row)
    status, event = alarm_states.follow(_status(row), condition, seen.rule, seen.at)
    alarm = _follow_one(
        connection,
        row,
        status,
        event,
        window=seen.window,
        finding=seen.finding if faulty else None,
        rule=seen.rule,
        now=seen.now,
    )
    return changed if alarm is None else [*changed, alarm]


_LISTED = tuple(state.value for state in ACTIVE)


def _suppressed(connection: Connection, row: Row[Any], aside: str, now: datetime) -> Followed:
    """An alarm that means nothing in the state that its machine is in: off the list by itself."""
    changes = {"state": AlarmState.SUPPRESSED.value, "suppressed_by": aside}
    event = AlarmEvent.SUPPRESS
    return Followed(_change(connection, row.id, changes, event, by=None, comment=aside, now=now))


def _released(connection: Connection, asset: str, now: datetime) -> list[Followed]:
    """The alarms of a machine that has left the state that suppressed them, as their conditions
    are.
    """
    hidden = (
        (alarms.c.asset_id == asset)
        & (alarms.c.state == AlarmState.SUPPRESSED.value)
        & alarms.c.suppressed_by.is_not(None)
    )
    rows = connection.execute(select(alarms).where(hidden).order_by(alarms.c.id)).all()
    return [
        Followed(
            operate(
                connection,
                row.id,
                AlarmEvent.RELEASE,
                by=None,
                comment=None,
                until=None,
                now=now,
            )
        )
        for row in rows
        if not _differs(row)
    ]


@dataclass(frozen=True)
class Followed:
    """An alarm after a finding that changed its state, or its text alone."""

    alarm: Alarm
    text_alone: bool = False

    def to_json(self) -> dict[str, Any]:
        """The alarm; with `text_alone` where its state is the one of before."""
        return self.alarm.to_json() | ({"text_alone": True} if self.text_alone else {})


def operate(
    connection: Connection,
    alarm: int,
    event: AlarmEvent,
    *,
    by: str | None,
    comment: str | None,
    until: datetime | None,
    now: datetime,
) -> Alarm:
    """What an operator asks for; IllegalTransition when the state does not allow it."""
    row = _row(connection, alarm)
    if _differs(row):
        raise row_checks.refuse(f"alarm {alarm}, which begins anew with its machine's next window")
    state = alarm_states.operate(_status(row), event).state
    changes: dict[str, Any] = {
        "state": state.value,
        "shelved_until": until if state is AlarmState.SHELVED else None,
        "suppressed_by": None,
    }
    if comment is not None:
        changes["comment"] = comment
    if event is AlarmEvent.ACKNOWLEDGE:
        changes |= {"acknowledged_at": now, "acknowledged_by": by}
    return _change(connection, alarm, changes, event, by=by, comment=comment, now=now)


def unshelve_expired(connection: Connection, now: datetime) -> list[Alarm]:
    """Put alarms back whose shelving has run out."""
    query = select(alarms).where(
        alarms.c.state == AlarmState.SHELVED.value, alarms.c.shelved_until <= now
    )
    expired = [row.id for row in connection.execute(query) if not _differs(row)]
    return [
        operate(connection, alarm, AlarmEvent.UNSHELVE, by=None, comment=None, until=None, now=now)
        for alarm in expired
    ]


def get(connection: Connection, alarm: int) -> Alarm:
    """One alarm."""
    return _alarm(_row(connection, alarm))


def page(
    connection: Connection,
    asset: str | None = None,
    active: bool = True,
    cursor: str | None = None,
    limit: int = 100,
    sites: Collection[str] | None = None,
) -> Page[Alarm]:
    """Alarms, the newest first."""
    query = (
        select(alarms)
        .where(paging.of_sites(alarms.c.asset_id, sites))
        .order_by(alarms.c.id.desc())
        .limit(limit + 1)
    )
    if asset is not None:
        query = query.where(alarms.c.asset_id == asset)
    if active:
        query = query.where(alarms.c.state != AlarmState.NORMAL.value)
    if cursor:
        query = query.where(alarms.c.id < paging.decode_number(cursor))
    return paging.page(connection.execute(query).all(), limit, "id", _alarm)


def changed_at(
    connection: Connection, asset: str, moments: Collection[datetime]
) -> Sequence[Alarm]:
    """The alarms of an asset whose journal has an entry of one of these moments: a finding's change
    has its finding's.
    """
    if not moments:
        return []
    changed = select(alarm_journal.c.alarm_id).where(alarm_journal.c.at.in_(moments))
    query = (
        select(alarms)
        .where(alarms.c.asset_id == asset, alarms.c.id.in_(changed))
        .order_by(alarms.c.id)
    )
    return [_alarm(row) for row in connection.execute(query)]


def journal(connection: Connection, alarm: int, limit: int = 100) -> Sequence[AlarmEntry]:
    """What happened to an alarm, newest first."""
    _row(connection, alarm)
    query = (
        select(alarm_journal)
        .where(alarm_journal.c.alarm_id == alarm)
        .order_by(alarm_journal.c.id.desc())
        .limit(limit)
    )
    return [_entry(row) for row in connection.execute(query)]


def _new(connection: Connection, asset: str, kind: str) -> Row[Any]:
    values = {"asset_id": asset, "kind": kind, **_NEVER_RAISED}
    return connection.execute(
        insert(alarms).values(row_checks.sealed(alarms, values)).returning(alarms)
    ).one()


def _differs(row: Row[Any]) -> bool:
    return row_checks.differs(alarms, row._mapping)


def _put(connection: Connection, alarm: int, changes: dict[str, Any]) -> Row[Any]:
    return row_checks.change(connection, alarms, alarm, lambda _row: changes)


def _begun_anew(connection: Connection, row: Row[Any], now: datetime) -> Row[Any]:
    """An alarm whose row is damaged, as one that was never raised: what it stood for is raised by
    the next finding that shows it.

    Nobody can tell any more whether it was acknowledged or shelved, and a window must not be lost
    for that.
    """
    stays = ("id", "asset_id", "kind", "checksum")
    values = {column.name: None for column in alarms.c if column.name not in stays} | _NEVER_RAISED
    values["checksum"] = row_checks.of_row(
        alarms, {"asset_id": row.asset_id, "kind": row.kind, **values}
    )
    connection.execute(update(alarms).where(alarms.c.id == row.id).values(values))
    comment = "its row differed from its checksum: it begins anew"
    _change(connection, row.id, {}, AlarmEvent.RESET, by=None, comment=comment, now=now)
    return _row(connection, row.id)


def _follow_one(
    connection: Connection,
    row: Row[Any],
    after: AlarmStatus,
    event: AlarmEvent | None,
    *,
    window: int,
    finding: Finding | None,
    rule: AlarmRule,
    now: datetime,
) -> Followed | None:
    changes: dict[str, Any] = asdict(after) | {"state": after.state.value}
    worse = {}
    if after.condition and finding is not None and row.kind == MACHINE:
        before = (
            json.loads(row.raised_by) if row.raised_by and event is not AlarmEvent.RAISE else []
        )
        changes["raised_by"] = json.dumps(
            sorted({*before, *beyond(finding.indicators, finding.thresholds)})
        )
    if after.condition and finding is not None:
        worst = severity(finding.indicators, finding.thresholds)
        if event is AlarmEvent.RAISE or row.worst is None or worst >= row.worst:
            worse = {
                "message": _message(finding),
                "window_id": window,
                "worst": worst,
                "worst_at": now,
            }
    changes |= worse
    if event is AlarmEvent.RAISE:
        priority = rule.priority(row.kind)
        changes["priority"] = None if priority is None else priority.value
        changes |= {"raised_at": now, "cleared_at": None, "occurrences": row.occurrences + 1}
        if after.state is AlarmState.UNACKNOWLEDGED:
            changes |= {"acknowledged_at": None, "acknowledged_by": None, "comment": None}
    if event is AlarmEvent.CLEAR:
        changes["cleared_at"] = now
    if event is not None:
        return Followed(
            _change(
                connection, row.id, changes, event, by=None, comment=None, now=now, flood=rule.flood
            )
        )
    changed = _put(connection, row.id, changes)
    return (
        Followed(_alarm(changed), text_alone=True)
        if worse and changed.message != row.message
        else None
    )


def _status(row: Row[Any]) -> AlarmStatus:
    return AlarmStatus(
        AlarmState(row.state),
        row.condition,
        row.pending_since,
        row.pending_seconds or 0.0,
        row.judged_at,
        row.judged_every,
    )


def _change(
    connection: Connection,
    alarm: int,
    changes: dict[str, Any],
    event: AlarmEvent,
    *,
    by: str | None,
    comment: str | None,
    now: datetime,
    flood: int = 0,
) -> Alarm:
    row = _put(connection, alarm, changes)
    entry = {
        "alarm_id": alarm,
        "at": now,
        "event": event.value,
        "state": row.state,
        "by": by,
        "comment": comment,
    }
    connection.execute(insert(alarm_journal).values(row_checks.sealed(alarm_journal, entry)))
    detail = {"asset": row.asset_id, "kind": row.kind, "state": row.state, "comment": comment}
    audit.append(
        connection, f"alarm {event.value}", f"alarm {alarm}", by=by, now=now, detail=detail
    )
    changed = _alarm(row)
    if not alarm_floods.takes(connection, event, flood, now):
        outbox.add(connection, changed)
    return changed


def _message(finding: Finding) -> str:
    return finding.reason or (
        f"{finding.diagnoser}: {finding.fault_class or finding.verdict.value}"
    )


def _row(connection: Connection, alarm: int) -> Row[Any]:
    row = connection.execute(select(alarms).where(alarms.c.id == alarm)).first()
    if row is None:
        raise NotFound(f"alarm {alarm}: there is none of this number")
    return row


def _with_times(row: Row[Any]) -> str:
    """The text, with when the alarm was raised and when what it tells was seen."""
    if row.raised_at is None:
        return str(row.message)
    since = f"{row.message}; since {row.raised_at:%Y-%m-%d %H:%M:%S} UTC"
    return (
        since
        if row.worst_at in (None, row.raised_at)
        else f"{since}, at its worst {row.worst_at:%Y-%m-%d %H:%M:%S} UTC"
    )


def _entry(row: Row[Any]) -> AlarmEntry:
    if row_checks.differs(alarm_journal, row._mapping):
        return AlarmEntry(row.at, "damaged", AlarmState.UNACKNOWLEDGED, None, row_checks.TELLS)
    return AlarmEntry(row.at, row.event, AlarmState(row.state), row.by, row.comment)


def _alarm(row: Row[Any]) -> Alarm:
    if _differs(row):
        return _damaged(row)
    return Alarm(
        row.id,
        row.asset_id,
        row.kind,
        AlarmState(row.state),
        row.condition,
        _with_times(row),
        row.worst_at,
        row.occurrences,
        row.raised_at,
        row.cleared_at,
        row.acknowledged_at,
        row.acknowledged_by,
        row.shelved_until,
        row.comment,
        row.window_id,
        row.priority,
        row.suppressed_by,
    )


def _damaged(row: Row[Any]) -> Alarm:
    """Shown as an alarm to look at: whatever it was, nobody has seen that it is damaged."""
    return Alarm(
        row.id,
        row.asset_id,
        row.kind,
        AlarmState.UNACKNOWLEDGED,
        condition=True,
        message=f"alarm {row.id}: {row_checks.TELLS}",
        worst_at=None,
        occurrences=0,
        raised_at=None,
        cleared_at=None,
        acknowledged_at=None,
        acknowledged_by=None,
        shelved_until=None,
        comment=None,
        window=None,
        priority=None,
        suppressed_by=None,
    )
