"""Rows of assets and findings."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from datetime import datetime
from typing import Any

from sqlalchemy import Connection, Row, Select, func, insert, select

from residuum.diagnosis.finding import RECORDED, Finding, Verdict
from residuum.service.storage.rows import paging, row_checks
from residuum.service.storage.tables import assets, findings, windows
from residuum.service.store import Asset, IndicatorHistory, NotFound, Page, StoredFinding

# What of a finding may be long.
_DOCUMENTS = (
    findings.c.indicators,
    findings.c.thresholds,
    findings.c.units,
    findings.c.evidence,
    findings.c.reason,
)
# Bytes of the indicators that are read for one history. Numbers alone, so that a curve over a long
# time may be larger than a list's page.
_HISTORY = 3 * paging.PAGE_BYTES


def ensure(
    connection: Connection, asset: str, title: str | None, diagnoser: str | None, now: datetime
) -> None:
    """Insert the asset, or change its title and diagnoser where they are given."""
    known = connection.execute(select(assets.c.id).where(assets.c.id == asset)).first()
    if known is None:
        row = {
            "id": asset,
            "title": title or asset,
            "diagnoser": diagnoser,
            "created_at": now,
            "windows": 0,
        }
        connection.execute(insert(assets).values(row_checks.sealed(assets, row)))
        return
    changes = {
        name: value
        for name, value in (("title", title), ("diagnoser", diagnoser))
        if value is not None
    }
    if changes:
        row_checks.change(connection, assets, asset, lambda _row: changes)


def add_finding(
    connection: Connection, asset: str, window: int, finding: Finding, now: datetime
) -> int:
    """Insert a finding and make it the asset's latest."""
    plain = finding.to_json()
    row = {
        name: plain[name]
        for name in (
            "diagnoser",
            "verdict",
            "indicators",
            "thresholds",
            "units",
            "evidence",
            "reason",
        )
    }
    values = {
        "asset_id": asset,
        "window_id": window,
        "at": now,
        "fault_class": finding.fault_class,
        **row,
    }
    query = insert(findings).values(row_checks.sealed(findings, values)).returning(findings.c.id)
    number: int = connection.execute(query).scalar_one()
    row_checks.change(
        connection,
        assets,
        asset,
        lambda row: {"last_finding_id": number, "windows": row["windows"] + 1},
    )
    return number


def require(connection: Connection, asset: str) -> None:
    """NotFound when there is no such asset."""
    if connection.execute(select(assets.c.id).where(assets.c.id == asset)).first() is None:
        raise NotFound(f"asset {asset!r}: there is none of this name; GET /assets lists them")


def get(connection: Connection, asset: str) -> Asset:
    """One asset with its latest finding."""
    row = connection.execute(_with_finding().where(assets.c.id == asset)).first()
    if row is None:
        raise NotFound(f"asset {asset!r}: there is none of this name; GET /assets lists them")
    return _asset(row)


def page(
    connection: Connection,
    cursor: str | None = None,
    limit: int = 100,
    sites: Collection[str] | None = None,
) -> Page[Asset]:
    """Assets by name."""
    query = _with_finding().where(paging.of_sites(assets.c.id, sites)).order_by(assets.c.id)
    if cursor:
        query = query.where(assets.c.id > paging.decode(cursor))
    listing = paging.Listing(query, assets.c.id, _DOCUMENTS)
    return paging.page_by_bytes(connection, listing, limit, "assets_id", _asset)


def findings_page(
    connection: Connection,
    asset: str,
    cursor: str | None = None,
    limit: int = 50,
    verdict: str | None = None,
) -> Page[StoredFinding]:
    """Findings of an asset, newest first."""
    require(connection, asset)
    query = select(findings).where(findings.c.asset_id == asset).order_by(findings.c.id.desc())
    if cursor:
        query = query.where(findings.c.id < paging.decode_number(cursor))
    if verdict:  # one that is none was damaged, and is told of
        query = query.where(
            (findings.c.verdict == verdict)
            | findings.c.verdict.not_in([member.value for member in Verdict])
        )
    return paging.page_by_bytes(connection, _listing(query), limit, "id", stored_finding)


def recorded_windows(connection: Connection, asset: str, limit: int = 500) -> Sequence[int]:
    """Windows with their signals that were kept before there was a baseline, oldest first."""
    query = select(findings.c.window_id).join_from(
        findings, windows, windows.c.id == findings.c.window_id
    )
    query = query.where(
        findings.c.asset_id == asset, findings.c.verdict == Verdict.NOT_ASSESSABLE.value
    )
    query = query.where(
        findings.c.evidence[RECORDED].as_boolean(), windows.c.signal_let_go_at.is_(None)
    )
    return (
        # the newest of them, told oldest first
        connection.execute(query.order_by(findings.c.id.desc()).limit(limit)).scalars().all()[::-1]
    )


def findings_after(
    connection: Connection, asset: str, number: int, limit: int = 100
) -> Sequence[StoredFinding]:
    """The first findings of an asset with a larger number, oldest first."""
    after = (findings.c.asset_id == asset) & (findings.c.id > number)
    query = select(findings).where(after).order_by(findings.c.id)
    rows, _ = paging.by_bytes(connection, _listing(query), limit)
    return [stored_finding(row) for row in rows]


def findings_between(
    connection: Connection,
    asset: str,
    begin: datetime,
    end: datetime,
    after: int = 0,
    limit: int = 500,
) -> Sequence[StoredFinding]:
    """The first findings of an asset in [begin, end) with a number larger than `after`, oldest
    first.
    """
    require(connection, asset)
    c = findings.c
    condition = (c.asset_id == asset) & (c.id > after) & (c.at >= begin) & (c.at < end)
    listing = _listing(select(findings).where(condition).order_by(c.id))
    rows, _ = paging.by_bytes(connection, listing, limit)
    return [stored_finding(row) for row in rows]


def _listing(query: Select[Any]) -> paging.Listing:
    return paging.Listing(query, findings.c.id, _DOCUMENTS)


def newest_finding(connection: Connection) -> int:
    """The largest number of a finding; 0 before there is one."""
    return connection.scalar(select(func.max(findings.c.id))) or 0


def finding_of(connection: Connection, window: int) -> StoredFinding:
    """The latest finding on a window."""
    query = (
        select(findings)
        .where(findings.c.window_id == window)
        .order_by(findings.c.id.desc())
        .limit(1)
    )
    row = connection.execute(query).first()
    if row is None:
        raise NotFound(f"window {window}: has no finding")
    return stored_finding(row)


def indicators(
    connection: Connection,
    asset: str,
    limit: int = 500,
    span: tuple[datetime | None, datetime | None] | None = None,
) -> IndicatorHistory:
    """Indicators and thresholds of the newest findings, oldest first; with a span, of findings
    spread over all of it.
    """
    require(connection, asset)
    documents = (findings.c.indicators, findings.c.thresholds, findings.c.units)
    columns = (*(findings.c[name] for name in row_checks.SHORT_OF_FINDING), findings.c.checksum)
    newest = select(*columns).where(findings.c.asset_id == asset).order_by(findings.c.id.desc())
    query = newest
    if span is not None:
        query = newest.where(findings.c.id.in_(_spread(connection, asset, span, limit)))
    listing = paging.Listing(query, findings.c.id, documents)
    newest_first, _ = paging.by_bytes(connection, listing, limit, _HISTORY)
    # Damaged rows have no place in a curve; a list of findings tells of them.
    rows = [row for row in reversed(newest_first) if not row_checks.differs(findings, row._mapping)]
    units: dict[str, str] = {}
    for row in rows:
        units |= row.units
    return IndicatorHistory(
        at=[row.at for row in rows],
        windows=[row.window_id for row in rows],
        verdicts=[row.verdict for row in rows],
        indicators=_columns([row.indicators for row in rows]),
        thresholds=_columns([row.thresholds for row in rows]),
        units=units,
    )


_WORST_FIRST = (Verdict.FAULTY.value, Verdict.NOT_ASSESSABLE.value)


def _spread(
    connection: Connection, asset: str, span: tuple[datetime | None, datetime | None], most: int
) -> Sequence[int]:
    """Findings of [begin, end), at most so many: of each stretch the worst verdict's, so that no
    fault is thinned away.
    """
    c = findings.c
    query = select(c.id, c.verdict).where(c.asset_id == asset).order_by(c.id)
    begin, end = span
    if begin is not None:
        query = query.where(c.at >= begin)
    if end is not None:
        query = query.where(c.at < end)
    rows = connection.execute(query).all()
    # rounded up, so that there are at most so many stretches
    stride = max(1, -(-len(rows) // most))
    stretches = (rows[first : first + stride] for first in range(0, len(rows), stride))
    rank = {verdict: place for place, verdict in enumerate(_WORST_FIRST)}
    return [
        min(stretch, key=lambda row: rank.get(row.verdict, len(rank))).id for stretch in stretches
    ]


def _columns(rows: list[dict[str, Any]]) -> dict[str, list[float | None]]:
    """A list a name, None where a row lacks it."""
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: [row.get(name) for row in rows] for name in names}


def _with_finding() -> Select[Any]:
    return select(*row_checks.labelled(assets), findings).join_from(
        assets, findings, findings.c.id == assets.c.last_finding_id, isouter=True
    )


def _asset(row: Row[Any]) -> Asset:
    last = stored_finding(row) if row.id is not None else None
    known = row_checks.of_labelled(assets, row)
    if not row_checks.differs(assets, known):
        return Asset(
            known["id"],
            known["title"],
            known["diagnoser"],
            known["created_at"],
            known["windows"],
            last,
        )
    damaged = _damaged(f"asset {known['id']}", str(known["diagnoser"]))
    # A damaged asset is shown with a finding that says so: a list without it would hide a machine.
    stand_in = StoredFinding(
        known["last_finding_id"] or 0, known["id"], 0, known["created_at"], damaged
    )
    return Asset(known["id"], known["id"], None, known["created_at"], known["windows"], stand_in)


def _damaged(subject: str, diagnoser: str) -> Finding:
    return Finding.not_assessable(diagnoser, f"{subject}: {row_checks.TELLS}")


def stored_finding(row: Row[Any]) -> StoredFinding:
    """The finding in a row of its table; that it cannot be told, where the row differs from its
    checksum.
    """
    if row_checks.differs(findings, row._mapping):
        return StoredFinding(
            row.id,
            row.asset_id,
            row.window_id,
            row.at,
            _damaged(f"finding {row.id}", str(row.diagnoser)),
        )
    finding = Finding(
        row.diagnoser,
        Verdict(row.verdict),
        row.fault_class,
        row.indicators,
        row.thresholds,
        row.units,
        row.evidence,
        row.reason,
    )
    return StoredFinding(row.id, row.asset_id, row.window_id, row.at, finding)
