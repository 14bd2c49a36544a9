"""The blocks that the rows point to: what must be on disk, with checksum and size."""

from __future__ import annotations

from typing import Any

from sqlalchemy import Connection, Select, select

from residuum.service.storage.blocks import BlockReference
from residuum.service.storage.tables import records, windows


def newest(connection: Connection, most: int) -> list[BlockReference]:
    """The newest blocks that rows point to: so many of windows and of records at most."""
    return [block for query in _queries() for block in _blocks(connection, query.limit(most))]


def references(connection: Connection) -> list[BlockReference]:
    """Every block that a row points to: signals of windows that are kept, and uploaded records;
    oldest first.
    """
    return [block for query in _queries() for block in reversed(_blocks(connection, query))]


def _queries() -> list[Select[Any]]:
    """The blocks of windows and of records, newest first."""
    queries = []
    for table, has_block in (
        (windows, windows.c.signal_let_go_at.is_(None)),
        (records, records.c.id.is_not(None)),
    ):
        columns = select(table.c.block_path, table.c.block_checksum, table.c.size_bytes)
        queries.append(columns.where(has_block).order_by(table.c.id.desc()))
    return queries


def _blocks(connection: Connection, query: Select[Any]) -> list[BlockReference]:
    return [BlockReference(*row) for row in connection.execute(query)]
