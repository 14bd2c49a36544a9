"""Rows of windows."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from typing import Any, NamedTuple

from sqlalchemy import Connection, Row, Select, insert, select

from residuum.identification.record import Record
from residuum.service.storage.blocks import BlockReference
from residuum.service.storage.rows import assets, paging, row_checks
from residuum.service.storage.tables import windows
from residuum.service.store import Conflict, NotFound, Page, StoredWindow


class RequestKey(NamedTuple):
    """The key under which a request may be sent again, and the digest of what was sent with it;
    a request without a key has None.
    """

    key: str | None = None
    digest: str | None = None


def add(
    connection: Connection,
    asset: str,
    record: Record,
    block: BlockReference,
    now: datetime,
    request: RequestKey,
) -> int:
    """Insert the row of a window whose block is on disk."""
    row = {
        "asset_id": asset,
        "received_at": now,
        "t0": record.t0,
        "sample_time": record.sample_time,
        "n": record.n,
        "units": dict(record.units),
        "source": record.source,
        "block_path": block.path,
        "block_checksum": block.checksum,
        "size_bytes": block.size_bytes,
        "idempotency_key": request.key,
        "digest": request.digest,
    }
    query = insert(windows).values(row_checks.sealed(windows, row)).returning(windows.c.id)
    number: int = connection.execute(query).scalar_one()
    return number


def _refuse_broken(row: Row[Any]) -> None:
    if row_checks.differs(windows, row._mapping):
        raise row_checks.refuse(f"window {row.id}")


def with_key(connection: Connection, asset: str, request: RequestKey) -> int | None:
    """The window stored under a key, None when there is none; Conflict when it was another
    window.
    """
    if request.key is None:
        return None
    query = select(windows.c.id, windows.c.digest).where(
        windows.c.asset_id == asset, windows.c.idempotency_key == request.key
    )
    row = connection.execute(query).first()
    if row is None:
        return None
    # A key that comes with another content is a client's mistake: answered with the first window,
    # the second one would be lost without a word.
    if row.digest != request.digest:
        raise Conflict(
            f"Idempotency-Key {request.key[:60]!r}: was used for another window of asset {asset!r}"
        )
    return int(row.id)


def get(connection: Connection, asset: str, window: int) -> StoredWindow:
    """One window of an asset."""
    return stored_window(row_of(connection, asset, window))


def row_of(connection: Connection, asset: str, window: int) -> Row[Any]:
    """The whole row, with the reference to the block."""
    query = select(windows).where(windows.c.asset_id == asset, windows.c.id == window)
    row = connection.execute(query).first()
    if row is None:
        raise NotFound(f"asset {asset!r}: has no window {window}")
    _refuse_broken(row)
    return row


def page(
    connection: Connection, asset: str, cursor: str | None = None, limit: int = 50
) -> Page[StoredWindow]:
    """Windows of an asset, newest first."""
    assets.require(connection, asset)
    query = select(windows).where(windows.c.asset_id == asset).order_by(windows.c.id.desc())
    if cursor:
        query = query.where(windows.c.id < paging.decode_number(cursor))
    return paging.page_by_bytes(connection, _listing(query), limit, "id", stored_window)


def between(
    connection: Connection,
    asset: str,
    begin: datetime,
    end: datetime,
    after: int = 0,
    limit: int = 500,
) -> Sequence[StoredWindow]:
    """The first windows of an asset received in [begin, end) with a number larger than `after`,
    oldest first.
    """
    assets.require(connection, asset)
    c = windows.c
    condition = (
        (c.asset_id == asset) & (c.id > after) & (c.received_at >= begin) & (c.received_at < end)
    )
    listing = _listing(select(windows).where(condition).order_by(c.id))
    rows, _ = paging.by_bytes(connection, listing, limit)
    return [stored_window(row) for row in rows]


def _listing(query: Select[Any]) -> paging.Listing:
    return paging.Listing(query, windows.c.id, (windows.c.units, windows.c.source))


def stored_window(row: Row[Any]) -> StoredWindow:
    """The window in a row of its table; StorageUnavailable where it differs from its checksum."""
    _refuse_broken(row)
    return StoredWindow(
        row.id,
        row.asset_id,
        row.received_at,
        row.t0,
        row.sample_time,
        row.n,
        row.units,
        row.source,
        row.size_bytes,
        row.signal_let_go_at,
    )
