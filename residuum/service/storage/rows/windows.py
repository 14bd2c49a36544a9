"""Rows of windows."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import Connection, Row, insert, select

from residuum.identification.record import Record
from residuum.service.storage.blocks import BlockReference
from residuum.service.storage.rows import assets, paging, row_checks
from residuum.service.storage.tables import windows
from residuum.service.store import Conflict, NotFound, Page, StoredWindow


def add(
    connection: Connection,
    asset: str,
    record: Record,
    block: BlockReference,
    *,
    now: datetime,
    idempotency_key: str | None,
    digest: str | None,
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
        "idempotency_key": idempotency_key,
        "digest": digest,
    }
    query = insert(windows).values(row_checks.sealed(windows, row)).returning(windows.c.id)
    number: int = connection.execute(query).scalar_one()
    return number


def _refuse_broken(row: Row[Any]) -> None:
    if row_checks.differs(windows, row._mapping):
        raise row_checks.refuse(f"window {row.id}")


def with_key(
    connection: Connection, asset: str, idempotency_key: str, digest: str | None
) -> int | None:
    """The window stored under a key, None when there is none; Conflict when it was another
    window.
    """
    query = select(windows.c.id, windows.c.digest).where(
        windows.c.asset_id == asset, windows.c.idempotency_key == idempotency_key
    )
    row = connection.execute(query).first()
    if row is None:
        return None
    if row.digest != digest:
        raise Conflict(
            f"Idempotency-Key {idempotency_key[:60]!r}: was used for another window of asset"
            f" {asset!r}"
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
    return paging.page_by_bytes(
        connection,
        query,
        windows.c.id,
        (windows.c.units, windows.c.source),
        limit,
        "id",
        stored_window,
    )


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
