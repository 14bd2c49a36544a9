"""Rows of alarms and of their journal. An asset has one alarm a kind: `machine` (a fault) and
`signal` (cannot be judged).
"""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import Connection, Row, func, insert, select, update

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
    furthest_beyond,
    in_deadband,
    severity,
)
from residuum.service.storage import audit, outbox
from residuum.service.storage.rows import alarm_floods, assets, paging, row_checks
from residuum.service.storage.tables import alarm_journal, alarms
from residuum.service.store import Alarm, AlarmEntry, NotFound, Page

_NEVER_RAISED = {
    "state": AlarmState.NORMAL.value,
    "condition": False,
    "message": "",
    "occurrences": 0,
}
# Verdict → the kinds of alarms that it tells of, each with whether its condition is shown.
_CONDITIONS: dict[Verdict, tuple[tuple[str, bool], ...]] = {
    Verdict.FAULTY: ((MACHINE, True), (SIGNAL, False)),
    Verdict.HEALTHY: ((MACHINE, False), (SIGNAL, False)),
    # A window that cannot be judged says nothing about the machine: its alarm stays as it is.
    Verdict.NOT_ASSESSABLE: ((SIGNAL, True),),
}
# Event of an alarm's journal: a work order was made of it, whose number ends the comment.
_ORDER, _WORK_ORDER = "order", "work order "
_LISTED = tuple(state.value for state in ACTIVE)


@dataclass(frozen=True)
class JudgedWindow:
    """A window that the alarms of its asset follow.

    Attributes
    ----------
    number : int
        Of the window's row.
    finding : Finding
    rule : AlarmRule
        Of the asset.
    now : datetime
        When it is stored, which journal and audit trail note.
    seen_at : datetime
        The window's own time, by which delays count: windows that a gateway sends late were not
        seen at once.
    suppressing_state : str or None
        The state of the machine that suppresses its alarms; empty for none, None where the window
        does not tell: then what is suppressed stays so, and nothing else becomes it.
    """

    number: int
    finding: Finding
    rule: AlarmRule
    now: datetime
    seen_at: datetime
    suppressing_state: str | None = ""

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
        # An indicator that was never above its threshold must not hold the alarm of another one.
        standing = row.kind == MACHINE and row.condition
        return standing and in_deadband(self.rule, indicators, thresholds, raised_by)


@dataclass(frozen=True)
class JournalNote:
    """What the journal and the audit trail say of a change; `by` None is the service itself."""

    event: AlarmEvent
    at: datetime
    by: str | None = None
    comment: str | None = None


def follow(connection: Connection, asset: str, window: JudgedWindow) -> list[Followed]:
    """Let an asset's alarms follow a window; returns the alarms that changed their state, or their
    text with a worse finding.
    """
    # Windows that are only kept for a baseline to come are no judgement of the machine.
    if window.finding.only_recorded:
        return []
    rows = _rows_by_kind(connection, asset, window.now)
    changed: list[Followed] = []
    # First, whatever the window says: most windows of a machine that stands tell nothing.
    if window.suppressing_state:
        changed += _suppress_listed(connection, rows, window)
    for kind, faulty in _CONDITIONS[window.verdict]:
        row = rows.get(kind)
        # An alarm has a row from its first fault on: healthy windows of an asset write none.
        if row is None and faulty:
            row = _new(connection, asset, kind)
        if row is not None:
            changed += _shown(connection, row, faulty, window)
    if window.verdict is Verdict.NOT_ASSESSABLE and MACHINE in rows:
        judged_at = alarm_states.unjudged(_status(rows[MACHINE])).judged_at
        _put(connection, rows[MACHINE].id, {"judged_at": judged_at})
    # Last, so that an alarm comes back onto the list by the condition that this window showed.
    if window.suppressing_state == "":
        changed += _released(connection, rows, window.now)
    return changed


def _rows_by_kind(connection: Connection, asset: str, now: datetime) -> dict[str, Row[Any]]:
    """The asset's alarms; damaged ones begin anew."""
    stored = connection.execute(select(alarms).where(alarms.c.asset_id == asset)).all()
    return {row.kind: _begun_anew(connection, row, now) if _differs(row) else row for row in stored}


def _suppress_listed(
    connection: Connection, rows: dict[str, Row[Any]], window: JudgedWindow
) -> list[Followed]:
    """Take the alarms on the list off it; `rows` then has them as they are."""
    changed = []
    for kind, row in rows.items():
        if row.state in _LISTED:
            changed.append(_suppressed(connection, row, window))
            rows[kind] = _row(connection, row.id)
    return changed


def _shown(
    connection: Connection, row: Row[Any], faulty: bool, window: JudgedWindow
) -> list[Followed]:
    """What becomes of one alarm whose condition a window shows, or shows no more."""
    changed = []
    # An alarm that the fault would raise is suppressed before it is: it must not come onto the
    # list for the moment in between.
    if window.suppressing_state and faulty and row.state == AlarmState.NORMAL.value:
        changed.append(_suppressed(connection, row, window))
        row = _row(connection, row.id)
    alarm = _follow_one(connection, row, faulty, window)
    return changed if alarm is None else [*changed, alarm]


def _suppressed(connection: Connection, row: Row[Any], window: JudgedWindow) -> Followed:
    """An alarm that means nothing in the state that its machine is in: off the list by itself."""
    state = window.suppressing_state
    changes = {"state": AlarmState.SUPPRESSED.value, "suppressed_by": state}
    note = JournalNote(AlarmEvent.SUPPRESS, window.now, comment=state)
    return Followed(_change(connection, row.id, changes, note))


def _released(
    connection: Connection, rows: Mapping[str, Row[Any]], now: datetime
) -> list[Followed]:
    """The alarms of a machine that has left the state that suppressed them, as their conditions
    are.
    """
    # What an operator suppressed has no state of the machine, and waits for the operator.
    hidden = [
        row.id
        for row in rows.values()
        if row.state == AlarmState.SUPPRESSED.value and row.suppressed_by is not None
    ]
    note = JournalNote(AlarmEvent.RELEASE, now)
    return [Followed(operate(connection, alarm, note)) for alarm in sorted(hidden)]


@dataclass(frozen=True)
class Followed:
    """An alarm after a finding that changed its state, or its text alone."""

    alarm: Alarm
    text_alone: bool = False

    def to_json(self) -> dict[str, Any]:
        """The alarm; with `text_alone` where its state is the one of before."""
        return self.alarm.to_json() | ({"text_alone": True} if self.text_alone else {})


def operate(
    connection: Connection, alarm: int, note: JournalNote, until: datetime | None = None
) -> Alarm:
    """What an operator asks for, `until` of shelving; IllegalTransition when the state does not
    allow it.
    """
    row = _row(connection, alarm)
    if _differs(row):
        raise row_checks.refuse(f"alarm {alarm}, which begins anew with its machine's next window")
    state = alarm_states.operate(_status(row), note.event).state
    changes: dict[str, Any] = {
        "state": state.value,
        "shelved_until": until if state is AlarmState.SHELVED else None,
        # Whatever an operator does ends what the machine's state did: it will not release it.
        "suppressed_by": None,
    }
    if note.comment is not None:
        changes["comment"] = note.comment
    if note.event is AlarmEvent.ACKNOWLEDGE:
        changes |= {"acknowledged_at": note.at, "acknowledged_by": note.by}
    return _change(connection, alarm, changes, note)


def unshelve_expired(connection: Connection, now: datetime) -> list[Alarm]:
    """Put alarms back whose shelving has run out."""
    query = select(alarms).where(
        alarms.c.state == AlarmState.SHELVED.value, alarms.c.shelved_until <= now
    )
    # all read before the first is changed: the query's rows are of the table that is written
    expired = [row.id for row in connection.execute(query) if not _differs(row)]
    note = JournalNote(AlarmEvent.UNSHELVE, now)
    return [operate(connection, alarm, note) for alarm in expired]


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
    _change(connection, row.id, {}, JournalNote(AlarmEvent.RESET, now, comment=comment))
    return _row(connection, row.id)


def _follow_one(
    connection: Connection, row: Row[Any], faulty: bool, window: JudgedWindow
) -> Followed | None:
    """The alarm, where its state or its text changed; its row keeps what its delays count."""
    condition = faulty or window.keeps(row)
    status, event = alarm_states.follow(_status(row), condition, window.rule, window.seen_at)
    changes: dict[str, Any] = asdict(status) | {"state": status.state.value}
    text: dict[str, Any] = {}
    if status.condition and faulty:
        text = _text_of_worse(row, event, window)
        if row.kind == MACHINE:
            changes["raised_by"] = _raised_by(row, event, window.finding)
    changes |= text
    if event is AlarmEvent.RAISE:
        changes |= _raising(row, status, window)
    if event is AlarmEvent.CLEAR:
        changes["cleared_at"] = window.now
    if event is not None:
        note = JournalNote(event, window.now)
        return Followed(_change(connection, row.id, changes, note, flood=window.rule.flood))
    changed = _put(connection, row.id, changes)
    if text and changed.message != row.message:
        return Followed(_alarm(changed), text_alone=True)
    return None


def _raised_by(row: Row[Any], event: AlarmEvent | None, finding: Finding) -> str:
    """The indicators that were above their thresholds since the alarm was raised, as JSON: the
    deadband holds for these alone.
    """
    before = json.loads(row.raised_by) if row.raised_by and event is not AlarmEvent.RAISE else []
    return json.dumps(sorted({*before, *beyond(finding.indicators, finding.thresholds)}))


def _text_of_worse(row: Row[Any], event: AlarmEvent | None, window: JudgedWindow) -> dict[str, Any]:
    """What the alarm says, where this finding is as bad as any since it was raised: an operator
    reads the worst, not the last.
    """
    worst = severity(window.finding.indicators, window.finding.thresholds)
    if event is not AlarmEvent.RAISE and row.worst is not None and worst < row.worst:
        return {}
    return {
        "message": _message(window.finding),
        "window_id": window.number,
        "worst": worst,
        "worst_at": window.now,
    }


def _raising(row: Row[Any], status: AlarmStatus, window: JudgedWindow) -> dict[str, Any]:
    priority = window.rule.priority(row.kind)
    changes: dict[str, Any] = {
        "priority": None if priority is None else priority.value,
        "raised_at": window.now,
        "cleared_at": None,
        "occurrences": row.occurrences + 1,
    }
    # An alarm raised while it is shelved or out of service keeps who put it there, and why.
    if status.state is AlarmState.UNACKNOWLEDGED:
        changes |= {"acknowledged_at": None, "acknowledged_by": None, "comment": None}
    return changes


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
    note: JournalNote,
    flood: int = 0,
) -> Alarm:
    """Change an alarm, with its entries in journal and audit trail and its notice for receivers,
    in one transaction: none of them tells of a change that was not kept.
    """
    row = _put(connection, alarm, changes)
    entry = {
        "alarm_id": alarm,
        "at": note.at,
        "event": note.event.value,
        "state": row.state,
        "by": note.by,
        "comment": note.comment,
    }
    first = _first_listed(connection, row)
    connection.execute(insert(alarm_journal).values(row_checks.sealed(alarm_journal, entry)))
    action, subject = f"alarm {note.event.value}", f"alarm {alarm}"
    detail = {"asset": row.asset_id, "kind": row.kind, "state": row.state, "comment": note.comment}
    audit.append(connection, action, subject, by=note.by, now=note.at, detail=detail)
    changed = _alarm(row)
    # In a flood its one notice stands for all alarms; what people do with alarms is told all the
    # same.
    if not alarm_floods.takes(connection, note.event, flood, note.at):
        told = changed.to_json() | {"change": note.event.value, "first": first}
        told["says"] = row.message
        outbox.add_notice(connection, told | {"exceeded": _exceeded(connection, row)})
    return changed


def _first_listed(connection: Connection, row: Row[Any]) -> bool:
    """Whether an alarm that comes onto the list now was not on it since it was normal the last
    time: one work order is enough for a fault that comes and goes unanswered.
    """
    if row.state != AlarmState.UNACKNOWLEDGED.value:
        return False
    c = alarm_journal.c
    of_alarm = c.alarm_id == row.id
    query = select(func.max(c.id)).where(of_alarm, c.state == AlarmState.NORMAL.value)
    listed = of_alarm & (c.state == row.state) & (c.id > (connection.scalar(query) or 0))
    return connection.execute(select(c.id).where(listed).limit(1)).first() is None


def note_order(
    connection: Connection, alarm: int, number: str, receiver: str, now: datetime
) -> None:
    """Keep the number of the work order that a receiver made of an alarm, in its journal and the
    audit trail.
    """
    row = _row(connection, alarm)
    entry = {"alarm_id": alarm, "at": now, "event": _ORDER, "state": row.state, "by": None}
    entry["comment"] = f"{_WORK_ORDER}{number}"
    connection.execute(insert(alarm_journal).values(row_checks.sealed(alarm_journal, entry)))
    detail = {"asset": row.asset_id, "order": number, "receiver": receiver}
    audit.append(connection, "alarm order", f"alarm {alarm}", by=None, now=now, detail=detail)


def order_of(connection: Connection, asset: str, at: datetime) -> str | None:
    """The number of the newest work order that was made of the fault of a machine that stood at a
    moment; None where none was.
    """
    c = alarm_journal.c
    query = (
        select(alarm_journal)
        .join_from(alarm_journal, alarms)
        .where(alarms.c.asset_id == asset, alarms.c.kind == MACHINE)
    )
    until = c.state == AlarmState.NORMAL.value
    # from when it was normal the last time until it was so again
    before = connection.execute(
        query.where(until, c.at <= at).order_by(c.id.desc()).limit(1)
    ).first()
    after = connection.execute(query.where(until, c.at > at).order_by(c.id).limit(1)).first()
    made = query.where(c.event == _ORDER)
    if before is not None:
        made = made.where(c.id > before.id)
    if after is not None:
        made = made.where(c.id < after.id)
    entry = connection.execute(made.order_by(c.id.desc()).limit(1)).first()
    if entry is None or row_checks.differs(alarm_journal, entry._mapping):
        return None
    return str(entry.comment).removeprefix(_WORK_ORDER)


def _exceeded(connection: Connection, row: Row[Any]) -> dict[str, Any] | None:
    """The indicator that lay furthest beyond its threshold in the alarm's worst finding, with both
    and their unit; None where there is none, or the finding was let go.
    """
    if row.kind != MACHINE or row.window_id is None:
        return None
    try:
        finding = assets.finding_of(connection, row.window_id).finding
    except NotFound:
        return None
    name = furthest_beyond(finding.indicators, finding.thresholds)
    if name is None:
        return None
    value, threshold = finding.indicators[name], finding.thresholds[name]
    unit = finding.units.get(name, "")
    return {"indicator": name, "value": value, "threshold": threshold, "unit": unit}


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
