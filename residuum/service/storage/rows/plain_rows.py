"""Rows of any schema revision as lines of JSON and back: the tables are read from the database, not
from the code.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Iterator
from datetime import datetime
from typing import Any

import orjson
from sqlalchemy import Connection, MetaData, Table, func, insert, select

_VERSION_TABLE = "alembic_version"
_AT_ONCE = 500


def tables_of(connection: Connection) -> list[Table]:
    """The tables there are, those that others point to first; without the one that keeps the
    schema's revision.
    """
    metadata = MetaData()
    metadata.reflect(connection)
    return [table for table in metadata.sorted_tables if table.name != _VERSION_TABLE]


def lines(connection: Connection, table: Table) -> Iterator[bytes]:
    """Every row as a line of JSON, in order of the primary key; bytes in Base64, moments as in ISO
    8601 (UTC).
    """
    query = select(table).order_by(*table.primary_key.columns)
    for row in connection.execute(query.execution_options(yield_per=_AT_ONCE)).mappings():
        yield orjson.dumps({str(name): _plain(value) for name, value in row.items()}) + b"\n"


def insert_lines(connection: Connection, table: Table, row_lines: Iterable[bytes]) -> None:
    """Insert rows that `lines` gave, and let the database count its numbers on from there."""
    kinds = {column.name: column.type.python_type for column in table.columns}
    batch = []
    for line in row_lines:
        batch.append(
            {name: _back(value, kinds[name]) for name, value in orjson.loads(line).items()}
        )
        if len(batch) == _AT_ONCE:
            connection.execute(insert(table), batch)
            batch = []
    if batch:
        connection.execute(insert(table), batch)
    _count_on(connection, table)


def _plain(value: Any) -> Any:
    return base64.b64encode(value).decode() if isinstance(value, bytes | memoryview) else value


def _back(value: Any, kind: type) -> Any:
    if value is None:
        return None
    if kind is bytes:
        return base64.b64decode(value)
    return datetime.fromisoformat(value) if kind is datetime else value


def _count_on(connection: Connection, table: Table) -> None:
    """PostgreSQL numbers rows by a sequence of its own, which rows with given numbers do not
    move.
    """
    if connection.dialect.name != "postgresql" or table.autoincrement_column is None:
        return
    column = table.autoincrement_column
    sequence = connection.scalar(select(func.pg_get_serial_sequence(table.name, column.name)))
    highest = connection.scalar(select(func.max(column)))
    if sequence is not None and highest is not None:
        connection.execute(select(func.setval(sequence, highest)))
