"""Outbox: changes of alarms that receivers are still to be told, written in the transaction of the change itself.

A notice is numbered without gaps under the lock of the audit trail, so that numbers are in the order of the commits. How far a
receiver has been told is kept beside; one process at a time tells it, and another takes over when that one was silent for `HELD`.
"""

from __future__ import annotations

import hashlib
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any

import orjson
from sqlalchemy import Connection, delete, func, insert, or_, select, update
from sqlalchemy.exc import IntegrityError

from residuum.service.storage.database import Database
from residuum.service.storage.tables import alarm_notices, receivers
from residuum.service.store import Alarm

KEPT = 1000
"""Notices that wait at most; the oldest go."""
HELD = timedelta(seconds=20)
"""How long a receiver is of the process that told it last: longer than one attempt takes."""


@dataclass(frozen=True)
class Notice:
    """A change of an alarm; `passed_over` are those before it that were let go untold."""

    number: int
    alarm: Mapping[str, Any]
    passed_over: int


def add(connection: Connection, alarm: Alarm) -> None:
    """Write a notice, after the entry of the audit trail in the same transaction."""
    number = (connection.scalar(select(func.max(alarm_notices.c.number))) or 0) + 1
    connection.execute(insert(alarm_notices).values(number=number, alarm=orjson.loads(orjson.dumps(alarm.to_json()))))
    connection.execute(delete(alarm_notices).where(alarm_notices.c.number <= number - KEPT))


class Outbox:
    """What one process sees of the notices."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._holder = secrets.token_hex(16)

    def register(self, address: str) -> str:
        """Make a receiver known: it is told what changes from its first registration on. Gives its id; addresses hold secrets."""
        receiver = hashlib.sha256(address.encode()).hexdigest()
        with self._database.read() as connection:
            known = connection.execute(select(receivers.c.id).where(receivers.c.id == receiver)).first()
        if known is None:
            try:
                with self._database.write() as connection:
                    newest = connection.scalar(select(func.max(alarm_notices.c.number))) or 0
                    connection.execute(insert(receivers).values(id=receiver, told=newest))
            except IntegrityError:
                """Another process was faster."""
        return receiver

    def next(self, receiver: str) -> Notice | None:
        """What the receiver is to be told now by this process, if anything."""
        here = receivers.c.id == receiver
        with self._database.read() as connection:
            row = connection.execute(select(receivers).where(here)).one()
            query = select(alarm_notices).where(alarm_notices.c.number > row.told).order_by(alarm_notices.c.number).limit(1)
            first = connection.execute(query).first()
        if first is None:
            return None
        now = datetime.now(UTC)
        free = or_(receivers.c.holder.is_(None), receivers.c.holder == self._holder, receivers.c.held_until < now)
        with self._database.write() as connection:
            mine = update(receivers).where(here, receivers.c.told == row.told, free)
            taken = connection.execute(mine.values(holder=self._holder, held_until=now + HELD)).rowcount
        return Notice(first.number, first.alarm, first.number - row.told - 1) if taken else None

    def told(self, receiver: str, notice: Notice) -> None:
        """Note that the receiver knows it."""
        held = (receivers.c.id == receiver, receivers.c.told < notice.number)
        with self._database.write() as connection:
            connection.execute(update(receivers).where(*held).values(told=notice.number))

    def release(self) -> None:
        """Let others tell the receivers of this process at once."""
        with self._database.write() as connection:
            connection.execute(update(receivers).where(receivers.c.holder == self._holder).values(holder=None))
