"""Windows and findings of a span of time, oldest first, some at a time."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

from sqlalchemy import Connection, select

from residuum.service.storage import tables as t
from residuum.service.storage.rows import assets, paging, windows
from residuum.service.store import StoredFinding, StoredWindow


def findings_between(
    connection: Connection,
    asset: str,
    begin: datetime,
    end: datetime,
    after: int = 0,
    limit: int = 500,
) -> Sequence[StoredFinding]:
    """The first findings of an asset in [begin, end) with a number larger than `after`."""
    assets.require(connection, asset)
    c = t.findings.c
    condition = (c.asset_id == asset) & (c.id > after) & (c.at >= begin) & (c.at < end)
    rows, _ = paging.by_bytes(
        connection,
        select(t.findings).where(condition).order_by(c.id),
        c.id,
        assets.DOCUMENTS,
        limit,
    )
    return [assets.stored_finding(row) for row in rows]


def windows_between(
    connection: Connection,
    asset: str,
    begin: datetime,
    end: datetime,
    after: int = 0,
    limit: int = 500,
) -> Sequence[StoredWindow]:
    """The first windows of an asset received in [begin, end) with a number larger than `after`."""
    assets.require(connection, asset)
    c = t.windows.c
    condition = (
        (c.asset_id == asset) & (c.id > after) & (c.received_at >= begin) & (c.received_at < end)
    )
    rows, _ = paging.by_bytes(
        connection,
        select(t.windows).where(condition).order_by(c.id),
        c.id,
        (c.units, c.source),
        limit,
    )
    return [windows.stored_window(row) for row in rows]
