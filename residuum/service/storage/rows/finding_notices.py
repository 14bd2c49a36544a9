"""Rows of findings that wait to be told: one a receiver that wants findings, written in the
transaction of the finding itself.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

from sqlalchemy import ColumnElement, Connection, delete, func, insert, literal, select, update

from residuum.service.storage.rows.assets import stored_finding
from residuum.service.storage.tables import finding_notices, findings, receivers
from residuum.service.store import StoredFinding

MOST_NOTICES_OF_FINDINGS = 10_000
"""Findings that wait for a receiver at most; the oldest go."""


def add(connection: Connection, finding: int) -> None:
    """Let a finding wait for everybody who wants findings; what is too old to wait any longer is
    let go and counted.
    """
    waiting = select(receivers.c.id, literal(finding)).where(receivers.c.findings)
    connection.execute(insert(finding_notices).from_select(["receiver_id", "finding_id"], waiting))
    _let_go(connection, finding_notices.c.finding_id <= finding - MOST_NOTICES_OF_FINDINGS)


def forget(connection: Connection, condition: ColumnElement[bool]) -> None:
    """Let go what waits of findings whose rows are about to go."""
    _let_go(connection, finding_notices.c.finding_id.in_(select(findings.c.id).where(condition)))


def waiting(connection: Connection, receiver: str, limit: int) -> Sequence[StoredFinding]:
    """The oldest findings that wait for a receiver, in their order."""
    query = select(findings).join_from(
        finding_notices, findings, findings.c.id == finding_notices.c.finding_id
    )
    query = (
        query.where(finding_notices.c.receiver_id == receiver)
        .order_by(finding_notices.c.finding_id)
        .limit(limit)
    )
    return [stored_finding(row) for row in connection.execute(query)]


def remove_told(connection: Connection, receiver: str, finding_ids: Collection[int]) -> None:
    """The receiver knows these findings."""
    theirs = finding_notices.c.receiver_id == receiver
    connection.execute(
        delete(finding_notices).where(theirs, finding_notices.c.finding_id.in_(finding_ids))
    )


def _let_go(connection: Connection, condition: ColumnElement[bool]) -> None:
    if (
        connection.execute(select(finding_notices.c.finding_id).where(condition).limit(1)).first()
        is None
    ):
        return
    # Counted for each receiver before the rows go, so that it can be told how many it missed.
    lost = (
        select(func.count())
        .select_from(finding_notices)
        .where(condition, finding_notices.c.receiver_id == receivers.c.id)
    )
    total = receivers.c.findings_lost + lost.scalar_subquery()
    connection.execute(update(receivers).where(receivers.c.findings).values(findings_lost=total))
    connection.execute(delete(finding_notices).where(condition))
