"""Outbox: changes of alarms, and findings, that receivers are still to be told, written in the
transaction of the change itself.

A notice of an alarm is numbered without gaps under the lock of the audit trail, so that numbers are
in the order of the commits. How far a receiver has been told is kept beside. A finding has a row
for every receiver that waits for it, which goes when it was told. One process at a time tells a
receiver, and another takes over when that one was silent for `HELD`.
"""

from __future__ import annotations

import hashlib
import secrets
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any

import orjson
from sqlalchemy import ColumnElement, Connection, delete, func, insert, or_, select, update
from sqlalchemy.exc import IntegrityError

from residuum.service.storage.database import Database
from residuum.service.storage.rows import finding_notices, row_checks
from residuum.service.storage.tables import alarm_notices, receivers
from residuum.service.store import StoredFinding

MOST_NOTICES = 1000
"""Notices that wait at most; the oldest go."""
HELD = timedelta(seconds=20)
"""How long a receiver is of the process that told it last: longer than one attempt takes."""
HANDED_OUT_AT_ONCE = 100
"""Findings that are handed out at once."""


@dataclass(frozen=True)
class Notice:
    """A change of an alarm, None where its row is damaged; `passed_over` are those before it that
    were let go untold.
    """

    number: int
    alarm: Mapping[str, Any] | None
    passed_over: int


@dataclass(frozen=True)
class WaitingFindings:
    """Findings that wait for a receiver; `lost` are those that were let go untold."""

    findings: Sequence[StoredFinding]
    lost: int


def add_notice(connection: Connection, notice: Mapping[str, Any]) -> None:
    """Write a notice of anything, after an entry of the audit trail in the same transaction."""
    # No other process is here: the lock of the audit trail's head is held until the commit.
    number = (connection.scalar(select(func.max(alarm_notices.c.number))) or 0) + 1
    row = {"number": number, "alarm": orjson.loads(orjson.dumps(notice))}
    connection.execute(insert(alarm_notices).values(row_checks.sealed(alarm_notices, row)))
    # Bounded, for a receiver that never comes back must not fill the database; what goes untold is
    # counted as `passed_over`.
    connection.execute(delete(alarm_notices).where(alarm_notices.c.number <= number - MOST_NOTICES))


def after(connection: Connection, last_number: int) -> Notice | None:
    """The notice that follows one that was told."""
    query = (
        select(alarm_notices)
        .where(alarm_notices.c.number > last_number)
        .order_by(alarm_notices.c.number)
        .limit(1)
    )
    row = connection.execute(query).first()
    if row is None:
        return None
    # A damaged notice is passed over: one that was no JSON any more held up its receiver, for ever,
    # from all that came behind it.
    alarm = None if row_checks.differs(alarm_notices, row._mapping) else row.alarm
    return Notice(row.number, alarm, row.number - last_number - 1)


class Outbox:
    """What one process sees of the notices."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._holder = secrets.token_hex(16)

    def register(self, address: str, *, findings: bool = False) -> str:
        """Make a receiver known: it is told what changes from its first registration on. Gives its
        id; addresses hold secrets.
        """
        receiver = hashlib.sha256(address.encode()).hexdigest()
        with self._database.read() as connection:
            known = connection.execute(
                select(receivers.c.findings).where(receivers.c.id == receiver)
            ).first()
        if known is None:
            try:
                with self._database.write() as connection:
                    newest = connection.scalar(select(func.max(alarm_notices.c.number))) or 0
                    connection.execute(
                        insert(receivers).values(id=receiver, told=newest, findings=findings)
                    )
            except IntegrityError:
                pass  # another process was faster, and wrote the same
        elif known.findings != findings:
            with self._database.write() as connection:
                connection.execute(
                    update(receivers).where(receivers.c.id == receiver).values(findings=findings)
                )
        return receiver

    def next(self, receiver: str) -> Notice | None:
        """What the receiver is to be told now by this process, if anything."""
        is_receiver = receivers.c.id == receiver
        with self._database.read() as connection:
            row = connection.execute(select(receivers).where(is_receiver)).one()
            first = after(connection, row.told)
        if first is None:
            return None
        # Only where nobody told it meanwhile: in between another process may have had its turn.
        with self._database.write() as connection:
            taken = self._take(connection, is_receiver, receivers.c.told == row.told)
        return first if taken else None

    def _take(self, connection: Connection, *conditions: ColumnElement[bool]) -> bool:
        """Whether this process may tell a receiver now; it then holds it for a while."""
        now = datetime.now(UTC)
        free = or_(
            receivers.c.holder.is_(None),
            receivers.c.holder == self._holder,
            receivers.c.held_until < now,
        )
        mine = (
            update(receivers)
            .where(*conditions, free)
            .values(holder=self._holder, held_until=now + HELD)
        )
        return bool(connection.execute(mine).rowcount)

    def told(self, receiver: str, notice: Notice) -> None:
        """Note that the receiver knows it."""
        # Forwards only: meanwhile another process may have taken over and be further on.
        held = (receivers.c.id == receiver, receivers.c.told < notice.number)
        with self._database.write() as connection:
            connection.execute(update(receivers).where(*held).values(told=notice.number))

    def findings(self, receiver: str) -> WaitingFindings:
        """The findings that the receiver is to be told now by this process, the oldest first; none
        while another tells it.
        """
        # Most of the time nothing waits, and a read does not queue for the lock of writers.
        with self._database.read() as connection:
            if not finding_notices.waiting(connection, receiver, 1):
                return WaitingFindings([], 0)
        with self._database.write() as connection:
            if not self._take(connection, receivers.c.id == receiver):
                return WaitingFindings([], 0)
            count = select(receivers.c.findings_lost).where(receivers.c.id == receiver)
            lost = connection.scalar(count) or 0
            waiting = finding_notices.waiting(connection, receiver, HANDED_OUT_AT_ONCE)
            return WaitingFindings(waiting, lost)

    def told_findings(self, receiver: str, finding_ids: Collection[int], lost: int = 0) -> None:
        """Note that the receiver knows these findings, and that it was noticed how many were let go
        before them.
        """
        with self._database.write() as connection:
            # its row first, as where notices are let go
            less = {"findings_lost": receivers.c.findings_lost - lost}
            connection.execute(update(receivers).where(receivers.c.id == receiver).values(less))
            finding_notices.remove_told(connection, receiver, finding_ids)

    def release(self) -> None:
        """Let others tell the receivers of this process at once."""
        with self._database.write() as connection:
            connection.execute(
                update(receivers).where(receivers.c.holder == self._holder).values(holder=None)
            )
