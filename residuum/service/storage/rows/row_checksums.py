"""A checksum in each row that is answered with: SQLite takes a bit that flipped in a value for another value."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from functools import partial
from typing import Any

import orjson
from sqlalchemy import Column, Connection, Label, LargeBinary, Row, Table, select, update

from residuum.service.storage.tables import (
    alarm_journal,
    alarms,
    assets,
    finding_hours,
    findings,
    model_versions,
    models,
    records,
    windows,
)
from residuum.service.store import StorageUnavailable

TELLS = "its row differs from its checksum, so the database's file is damaged: `residuum doctor` names all"
"""What is said of a row that cannot be answered with."""
_SHORT = ("asset_id", "window_id", "at", "diagnoser", "verdict", "fault_class", "indicators", "thresholds", "units")
_PARTS_OF_FINDING = (_SHORT, ("reason",), ("evidence",))
_WINDOW = (
    "asset_id",
    "received_at",
    "t0",
    "sample_time",
    "n",
    "units",
    "source",
    "block_path",
    "block_checksum",
    "size_bytes",
    "idempotency_key",
    "digest",
)
SHORT_OF_FINDING = _SHORT
"""Columns of a finding that the first part of its checksum is of: a history reads no others."""


def of_finding(values: Mapping[Any, Any]) -> str:
    """The checksum of a finding's columns: 8 hexadecimal digits of those that a history needs, of the reason, of the evidence."""
    return "".join(_crc([values[name] for name in part]) for part in _PARTS_OF_FINDING)


def of_window(values: Mapping[Any, Any]) -> str:
    """The checksum of a window's columns, but for the moment at which its signal is let go."""
    return _crc([values[name] for name in _WINDOW])


def of_row(table: Table, values: Mapping[Any, Any]) -> str:
    """The checksum of a row of another table: of all columns but its number, large content, and the checksum itself."""
    return _crc([values.get(column.name) for column in table.columns if _counts(table, column)])


def differs(table: Table, values: Mapping[Any, Any]) -> bool:
    """Whether such a row differs from its checksum. One without any does: the end of a row is lost by a flip in its head."""
    return bool(values[_own(table)] != of_row(table, values))


def sealed(table: Table, values: Mapping[str, Any]) -> dict[str, Any]:
    """The values of a new row, with its checksum."""
    return {**values, _own(table): of_row(table, values)}


def change(connection: Connection, table: Table, key: Any, changes: Callable[[Mapping[Any, Any]], dict[str, Any]]) -> Row[Any]:
    """Change the row of a key by what it was, and its checksum; one that differs from it goes on doing so. Gives the new row.

    The row is held from before it is read until the transaction ends: nobody changes it between its values and their checksum.
    """
    here = table.c.id == key
    before = connection.execute(select(table).where(here).with_for_update()).one()._mapping
    new = changes(before)
    if not differs(table, before):
        new[_own(table)] = of_row(table, {**before, **new})
    return connection.execute(update(table).where(here).values(new).returning(table)).one()


def labelled(table: Table) -> list[Label[Any]]:
    """All columns of a table that is joined to another, under names that are no other's: `of_labelled` takes them back."""
    return [column.label(f"{table.name}_{column.name}") for column in table.columns]


def of_labelled(table: Table, row: Row[Any]) -> dict[str, Any]:
    """The columns of a table in a row that was asked for with `labelled`."""
    return {column.name: row._mapping[f"{table.name}_{column.name}"] for column in table.columns}


def refuse(what: str) -> StorageUnavailable:
    """That something cannot be answered with."""
    return StorageUnavailable(f"database: {what}: {TELLS}")


def _own(table: Table) -> str:
    return "row_checksum" if "row_checksum" in table.columns else "checksum"


def _counts(table: Table, column: Column[Any]) -> bool:
    """A number is given by the database, and an index of ours or a constraint holds it; a file has a checksum of its own."""
    return column is not table.autoincrement_column and column.name != _own(table) and not isinstance(column.type, LargeBinary)


def finding_differs(values: Mapping[Any, Any]) -> bool:
    """Whether a finding's row, as far as it was read, differs from its checksum."""
    checksum = values["checksum"] or ""
    return any(
        _crc([values[name] for name in part]) != checksum[8 * k : 8 * k + 8]
        for k, part in enumerate(_PARTS_OF_FINDING)
        if part[0] in values
    )


def window_differs(values: Mapping[Any, Any]) -> bool:
    """Whether a window's row differs from its checksum."""
    return bool(values["checksum"] != of_window(values))


def seal_rows_of_old(connection: Connection) -> None:
    """Give each row its checksum that was written before rows had any, as it is now."""
    for table in (assets, windows, findings, finding_hours, alarms, alarm_journal, records, models, model_versions):
        own = table.c[_own(table)]
        of = {"windows": of_window, "findings": of_finding}.get(table.name, partial(of_row, table))
        numbers = list(table.primary_key)
        old = connection.execute(select(*numbers).where(own.is_(None))).all()
        for key in old:
            here = [column == value for column, value in zip(numbers, key, strict=True)]
            row = connection.execute(select(table).where(*here)).one()
            connection.execute(update(table).where(*here).values({own: of(row._mapping)}))


def _crc(values: Sequence[Any]) -> str:
    return f"{zlib.crc32(orjson.dumps(_plain(values), option=orjson.OPT_SORT_KEYS)):08x}"


def _plain(value: Any) -> Any:
    """The value as either database gives it back: a document of PostgreSQL tells 1.0 and 1 alike, and 0.0 and −0.0."""
    if isinstance(value, datetime):
        return value.astimezone(UTC).isoformat()
    if isinstance(value, int | float) and not isinstance(value, bool):
        return repr(float(value) + 0.0) if abs(value) < 1e300 else str(value)
    if isinstance(value, Mapping):
        return {str(name): _plain(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return value
