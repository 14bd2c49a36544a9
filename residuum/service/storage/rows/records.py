"""Rows of uploaded records."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import Connection, Row, delete, insert, select

from residuum.identification.record import Record
from residuum.service.storage.blocks import BlockReference
from residuum.service.storage.rows import paging, row_checks
from residuum.service.storage.tables import records
from residuum.service.store import NotFound, Page, StoredRecord


def add(
    connection: Connection, name: str, record: Record, block: BlockReference, now: datetime
) -> int:
    """Insert the row of a record whose block is on disk."""
    row = {
        "name": name,
        "created_at": now,
        "t0": record.t0,
        "sample_time": record.sample_time,
        "n": record.n,
        "units": dict(record.units),
        "notes": list(record.notes),
        "block_path": block.path,
        "block_checksum": block.checksum,
        "size_bytes": block.size_bytes,
    }
    sealed = row_checks.sealed(records, row)
    number: int = connection.execute(
        insert(records).values(sealed).returning(records.c.id)
    ).scalar_one()
    return number


def row_of(connection: Connection, record: int) -> Row[Any]:
    """The whole row, with the reference to the block."""
    row = connection.execute(select(records).where(records.c.id == record)).first()
    if row is None:
        raise NotFound(f"record {record}: there is none of this number")
    return _whole(row)


def _whole(row: Row[Any]) -> Row[Any]:
    if row_checks.differs(records, row._mapping):
        raise row_checks.refuse(f"record {row.id}")
    return row


def get(connection: Connection, record: int) -> StoredRecord:
    """One record."""
    return _record(row_of(connection, record))


def remove(connection: Connection, record: int) -> str:
    """Delete the row of a record; returns its block's path. NotFound when there is none."""
    path = str(row_of(connection, record).block_path)
    connection.execute(delete(records).where(records.c.id == record))
    return path


def page(connection: Connection, cursor: str | None = None, limit: int = 50) -> Page[StoredRecord]:
    """Records, newest first."""
    query = select(records).order_by(records.c.id.desc())
    if cursor:
        query = query.where(records.c.id < paging.decode_number(cursor))
    listing = paging.Listing(query, records.c.id, (records.c.units, records.c.notes))
    return paging.page_by_bytes(connection, listing, limit, "id", _record)


def _record(row: Row[Any]) -> StoredRecord:
    row = _whole(row)
    return StoredRecord(
        row.id,
        row.name,
        row.created_at,
        row.t0,
        row.sample_time,
        row.n,
        row.units,
        row.notes,
        row.size_bytes,
    )
