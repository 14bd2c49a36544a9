"""Audit trail: what was done, by whom, each entry chained to the one before, so that an edit or a
deletion shows.

digest_k = SHA-256(digest_{k−1} ‖ number, time, who, action, subject, detail), digest_0 = 0; the
head row keeps the last number and digest. Who can write the database and knows this page can forge
a whole new chain: the head that `residuum doctor` prints, noted elsewhere, shows that too.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any, NamedTuple

import orjson
from sqlalchemy import Connection, Row, insert, select, update

from residuum.service.storage.rows import paging
from residuum.service.storage.tables import audit, audit_head
from residuum.service.store import AuditEntry, Page, StorageUnavailable

# The digest before the first entry.
_BEGIN = "0" * 64
# Entries that are fetched at once.
_AT_ONCE = 1000


class BrokenAudit(Exception):
    """The trail is not what was written; the message names the first entry that does not fit."""


@dataclass(frozen=True)
class AuditHead:
    """The end of the trail: how many entries, and the digest over all of them."""

    entries: int
    digest: str


def append(
    connection: Connection,
    action: str,
    subject: str,
    *,
    by: str | None,
    now: datetime,
    detail: Mapping[str, Any] | None = None,
) -> None:
    """Add an entry in the transaction of what it tells of."""
    # Held until the transaction ends: two entries must not follow the same one.
    head = connection.execute(select(audit_head).with_for_update()).one()
    # sorted: the digest is over this text
    detail_json = orjson.dumps(dict(detail or {}), option=orjson.OPT_SORT_KEYS).decode()
    number = head.entries + 1
    content = _Content(number, now, by, action, subject, detail_json)
    digest = content.digest(head.digest)
    connection.execute(insert(audit).values(content._asdict() | {"digest": digest}))
    connection.execute(update(audit_head).values(entries=number, digest=digest))


def touch(connection: Connection) -> None:
    """Write the head as it is: whether the database can be written shows only when something is."""
    connection.execute(update(audit_head).values(entries=audit_head.c.entries))


def verify(connection: Connection) -> AuditHead:
    """The head of a trail that is whole; BrokenAudit where it is not."""
    try:
        number, digest = _followed(connection)
    except (AttributeError, TypeError, ValueError) as error:  # SQLite keeps anything in any column
        raise BrokenAudit(f"audit: an entry was changed into none: {error}") from None
    heads = connection.execute(select(audit_head)).all()
    if [(head.entries, head.digest) for head in heads] != [(number, digest)]:
        raise BrokenAudit(
            f"audit: its head does not fit the last entry, {number}: entries at the end were"
            " removed or added"
        )
    return AuditHead(number, digest)


def _followed(connection: Connection) -> tuple[int, str]:
    """The number of the last entry, and the digest over all."""
    number, digest = 0, _BEGIN
    for row in connection.execute(
        select(audit).order_by(audit.c.number).execution_options(yield_per=_AT_ONCE)
    ):
        number += 1
        if row.number != number:
            # numbers run without gaps: the head's lock gives them
            raise BrokenAudit(f"audit: entry {number} is missing")
        digest = _content(row).digest(digest)
        if row.digest != digest:
            raise BrokenAudit(f"audit: entry {number} or the one before it was changed")
    return number, digest


def page(connection: Connection, cursor: str | None = None, limit: int = 100) -> Page[AuditEntry]:
    """Entries, newest first."""
    query = select(audit).order_by(audit.c.number.desc()).limit(limit + 1)
    if cursor:
        query = query.where(audit.c.number < paging.decode_number(cursor))
    rows = connection.execute(query).all()
    # The digest before each is that of the next row, for the newest comes first; the row beyond
    # the page gives that of the last one shown.
    before = [entry.digest for entry in rows[1:]] + ([_BEGIN] if len(rows) <= limit else [])
    for row, digest_before in zip(rows, before, strict=False):
        if _content(row).digest(digest_before) != row.digest:
            raise StorageUnavailable(
                f"audit: entry {row.number} or the one before it was changed; `residuum doctor`"
                " names the first"
            )
    return paging.page(rows, limit, "number", _entry)


class _Content(NamedTuple):
    """What an entry's digest is over, as its row has it."""

    number: int
    at: datetime
    by: str | None
    action: str
    subject: str
    detail: str

    def digest(self, before: str) -> str:
        """The entry's digest after the digest of the one before it."""
        content = orjson.dumps([self.number, self.at.isoformat(), *self[2:]])
        return hashlib.sha256(before.encode() + content).hexdigest()


def _content(row: Row[Any]) -> _Content:
    return _Content(row.number, row.at, row.by, row.action, row.subject, row.detail)


def _entry(row: Row[Any]) -> AuditEntry:
    return AuditEntry(
        row.number, row.at, row.by, row.action, row.subject, orjson.loads(row.detail), row.digest
    )
