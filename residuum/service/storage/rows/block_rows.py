"""The blocks that the rows point to: what must be on disk, with checksum and size."""

from __future__ import annotations

from sqlalchemy import Connection, select

from residuum.service.storage.blocks import BlockReference
from residuum.service.storage.tables import records, windows


def references(connection: Connection) -> list[BlockReference]:
    """Every block that a row points to: signals of windows that are kept, and uploaded records; oldest first."""
    found = []
    for table, kept in ((windows, windows.c.signal_let_go_at.is_(None)), (records, records.c.id.is_not(None))):
        columns = select(table.c.block_path, table.c.block_checksum, table.c.size_bytes)
        found += [BlockReference(*row) for row in connection.execute(columns.where(kept).order_by(table.c.id))]
    return found
