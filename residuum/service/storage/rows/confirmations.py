"""Rows of what was found at machines of what findings said: never changed, the newest on a finding
counts.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from functools import wraps
from typing import Any, Concatenate, ParamSpec

from sqlalchemy import ColumnElement, Connection, Row, func, insert, select, true

from residuum.diagnosis.finding import Verdict
from residuum.identification.errors import BadInput
from residuum.service.storage import audit
from residuum.service.storage.rows import alarms, assets, paging, row_checks
from residuum.service.storage.tables import confirmations, findings
from residuum.service.store import (
    Asset,
    Confirmation,
    FoundAtMachine,
    NotFound,
    Outcome,
    Page,
    StoredFinding,
    T,
)

P = ParamSpec("P")
Span = tuple[datetime | None, datetime | None]

DAMAGED = "damaged"
# By how much the clock of who tells may be ahead of ours.
_CLOCKS_APART = timedelta(minutes=1)


def add(
    connection: Connection,
    asset: str,
    finding: int,
    observed: FoundAtMachine,
    *,
    by: str | None,
    now: datetime,
) -> Confirmation:
    """Keep what was found of a finding, with its entry in the audit trail.

    Raises
    ------
    NotFound
        No such finding of this asset.
    BadInput
        What was found contradicts itself or what was said.
    """
    stored = _finding(connection, asset, finding)
    _refuse_contradictions(stored, observed, now)
    statement = stored.finding.statement
    # What the finding said is copied: its row may be let go, and the answer must go on to be
    # counted by what was said.
    row = {
        "asset_id": asset,
        "finding_id": finding,
        "window_id": stored.window,
        "finding_at": stored.at,
        "diagnoser": stored.finding.diagnoser,
        "verdict": stored.finding.verdict.value,
        "said": statement.says,
        "probability": statement.probability,
        "outcome": observed.outcome.value,
        "cause": observed.cause,
        "part": observed.part,
        # the one that a receiver made of the alarm, where nobody names another
        "order_number": observed.order or alarms.order_of(connection, asset, stored.at),
        "who": observed.who or by or "",
        "found_at": observed.found_at or now,
        "note": observed.note,
        "healthy": observed.healthy,
        "at": now,
        "by": by,
    }
    query = insert(confirmations).values(row_checks.sealed(confirmations, row))
    confirmation = _confirmation(connection.execute(query.returning(confirmations)).one())
    detail = {"asset": asset, "confirmation": confirmation.id}
    detail |= {name: row[name] for name in ("said", "outcome", "cause", "part", "order_number")}
    detail |= {name: row[name] for name in ("who", "found_at", "note", "healthy")}
    action = f"finding {observed.outcome.value}"
    audit.append(connection, action, f"finding {finding}", by=by, now=now, detail=detail)
    return confirmation


def page(
    connection: Connection,
    span: Span = (None, None),
    asset: str | None = None,
    diagnosis: str | None = None,
    cursor: str | None = None,
    limit: int = 100,
    sites: Collection[str] | None = None,
) -> Page[Confirmation]:
    """What was told of findings of [begin, end), None for an open end, the newest first.

    `diagnosis` is what was said, or what it was corrected to.
    """
    c = confirmations.c
    query = (
        select(confirmations).where(_of(span, asset, sites)).order_by(c.id.desc()).limit(limit + 1)
    )
    if diagnosis is not None:
        query = query.where((c.said == diagnosis) | (c.cause == diagnosis))
    if cursor:
        query = query.where(c.id < paging.decode_number(cursor))
    return paging.page(connection.execute(query).all(), limit, "id", _confirmation)


def standing(
    connection: Connection,
    span: Span = (None, None),
    asset: str | None = None,
    sites: Collection[str] | None = None,
) -> Sequence[Confirmation]:
    """The newest on each finding of [begin, end), oldest first; StorageUnavailable where one of
    them is damaged: a count would be wrong.
    """
    c = confirmations.c
    # By number, not by time: the newest answer on a finding is the one that was given last.
    newest = select(func.max(c.id)).where(_of(span, asset, sites)).group_by(c.finding_id)
    query = select(confirmations).where(c.id.in_(newest)).order_by(c.id)
    counted = [_confirmation(row) for row in connection.execute(query)]
    broken = [answer.id for answer in counted if answer.outcome == DAMAGED]
    if broken:
        raise row_checks.refuse(f"confirmation {broken[0]}")
    return counted


def with_confirmations(
    connection: Connection, stored: Sequence[StoredFinding]
) -> list[StoredFinding]:
    """The findings, each with the newest of what was found."""
    c = confirmations.c
    newest = (
        select(func.max(c.id))
        .where(c.finding_id.in_([finding.id for finding in stored]))
        .group_by(c.finding_id)
    )
    rows = connection.execute(select(confirmations).where(c.id.in_(newest)))
    known = {row.finding_id: _confirmation(row) for row in rows}
    return [replace(finding, confirmation=known.get(finding.id)) for finding in stored]


def finding_of(connection: Connection, window: int) -> StoredFinding:
    """The latest finding on a window, with what was found."""
    return with_confirmations(connection, [assets.finding_of(connection, window)])[0]


def asset_of(connection: Connection, asset: str) -> Asset:
    """One asset with its latest finding, and what was found."""
    return _with_last(connection, [assets.get(connection, asset)])[0]


def _with_last(connection: Connection, known: Sequence[Asset]) -> list[Asset]:
    last = [asset.last_finding for asset in known if asset.last_finding is not None]
    answered = {finding.id: finding for finding in with_confirmations(connection, last)}
    return [
        asset
        if asset.last_finding is None
        else replace(asset, last_finding=answered[asset.last_finding.id])
        for asset in known
    ]


def _answered(
    list_page: Callable[Concatenate[Connection, P], Page[T]],
    with_answers: Callable[[Connection, Sequence[T]], list[T]],
) -> Callable[Concatenate[Connection, P], Page[T]]:
    """A list of `assets`, asked for as there, each item with what was found."""

    @wraps(list_page)
    def answered_page(connection: Connection, /, *given: P.args, **named: P.kwargs) -> Page[T]:
        page = list_page(connection, *given, **named)
        return replace(page, items=with_answers(connection, page.items))

    return answered_page


findings_page = _answered(assets.findings_page, with_confirmations)
assets_page = _answered(assets.page, _with_last)


def _finding(connection: Connection, asset: str, finding: int) -> StoredFinding:
    assets.require(connection, asset)
    is_it = (findings.c.id == finding) & (findings.c.asset_id == asset)
    row = connection.execute(select(findings).where(is_it)).first()
    if row is None:
        raise NotFound(
            f"asset {asset!r}: has no finding {finding}; GET /assets/{asset}/findings lists them"
        )
    if row_checks.differs(findings, row._mapping):
        raise row_checks.refuse(f"finding {finding}")
    return assets.stored_finding(row)


def _refuse_contradictions(stored: StoredFinding, observed: FoundAtMachine, now: datetime) -> None:
    verdict = stored.finding.verdict
    if verdict is Verdict.NOT_ASSESSABLE:
        raise BadInput(
            f"finding {stored.id}: its window could not be judged, so it says nothing that can be"
            " confirmed; take a finding that is healthy or faulty"
        )
    _refuse_cause(observed, stored.finding.statement.says)
    refuted_fault = verdict is Verdict.FAULTY and observed.outcome is Outcome.REFUTED
    if observed.healthy and not refuted_fault:
        raise BadInput(
            "body, healthy: only the window of a refuted fault joins the healthy ones; leave it out"
        )
    if observed.found_at is not None and observed.found_at > now + _CLOCKS_APART:
        raise BadInput(
            f"body, found_at: {observed.found_at.isoformat()} lies in the future; leave it out for"
            " now"
        )


def _refuse_cause(observed: FoundAtMachine, diagnosis: str) -> None:
    named_another = observed.cause not in (None, diagnosis)
    if observed.outcome is Outcome.CORRECTED and not named_another:
        raise BadInput(
            f"body, cause: 'corrected' needs what it was instead of {diagnosis!r}; where it was"
            " that, say 'confirmed'"
        )
    if observed.outcome is not Outcome.CORRECTED and named_another:
        raise BadInput(
            f"body, cause {observed.cause!r}: {observed.outcome.value!r} has no other cause than"
            f" {diagnosis!r}; say 'corrected'"
        )


def _of(span: Span, asset: str | None, sites: Collection[str] | None) -> ColumnElement[bool]:
    c = confirmations.c
    begin, end = span
    where = paging.of_sites(c.asset_id, sites) & (true() if asset is None else c.asset_id == asset)
    where &= true() if begin is None else c.finding_at >= begin
    return where & (true() if end is None else c.finding_at < end)


def _confirmation(row: Row[Any]) -> Confirmation:
    confirmation = Confirmation(
        row.id,
        row.asset_id,
        row.finding_id,
        row.window_id,
        row.finding_at,
        row.diagnoser,
        row.verdict,
        row.said,
        row.probability,
        row.outcome,
        row.cause,
        row.part,
        row.order_number,
        row.who,
        row.found_at,
        row.note,
        row.healthy,
        row.at,
        row.by,
    )
    if not row_checks.differs(confirmations, row._mapping):
        return confirmation
    return replace(confirmation, outcome=DAMAGED, note=row_checks.TELLS, cause=None, healthy=False)
