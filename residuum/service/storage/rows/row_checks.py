"""Whether the rows of a database agree with each other: what no constraint says, and a hand or a
damaged disk may break.
"""

from __future__ import annotations

import hashlib
import math
import time
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from typing import Any

import orjson
from sqlalchemy import (
    Column,
    ColumnElement,
    Connection,
    Label,
    LargeBinary,
    Row,
    ScalarSelect,
    Select,
    Table,
    func,
    select,
    update,
)

from residuum.diagnosis.finding import Verdict
from residuum.service.alarms.alarm_states import AlarmState
from residuum.service.storage.tables import (
    alarm_floods,
    alarm_journal,
    alarm_notices,
    alarms,
    assets,
    confirmations,
    finding_hours,
    findings,
    model_versions,
    models,
    records,
    windows,
)
from residuum.service.store import StorageUnavailable

# A checksum in each row that is answered with: SQLite takes a bit that flipped in a value for
# another value. Of 1500 flips in its pages 27 were answered with as other values; with a checksum
# none was.

TELLS = (
    "its row differs from its checksum, so the database's file is damaged: `residuum doctor`"
    " names all"
)
"""What is said of a row that cannot be answered with."""
SHORT_OF_FINDING = (
    "asset_id",
    "window_id",
    "at",
    "diagnoser",
    "verdict",
    "fault_class",
    "indicators",
    "thresholds",
    "units",
)
"""Columns of a finding that the first part of its checksum is of: a history reads no others."""
_PARTS_OF_FINDING = (SHORT_OF_FINDING, ("reason",), ("evidence",))
SEALED: Mapping[Table, tuple[str, str]] = {
    windows: ("0010", "window {id} of {asset_id!r}"),
    findings: ("0010", "finding {id} of {asset_id!r}"),
    assets: ("0010", "asset {id!r}"),
    alarms: ("0010", "alarm {id} of {asset_id!r}"),
    models: ("0010", "model {id!r}"),
    model_versions: ("0010", "model {model_id!r}, version {number}"),
    alarm_journal: ("0010", "entry {id} of alarms' journal"),
    records: ("0010", "record {id}"),
    finding_hours: ("0010", "hour {hour} of {asset_id!r}"),
    alarm_notices: ("0011", "notice {number} of an alarm"),
    alarm_floods: ("0014", "flood {id} of alarms"),
    confirmations: ("0012", "confirmation {id} of {asset_id!r}"),
}
"""The tables whose rows have a checksum: since which revision of the schema, and what a row of
theirs is called.
"""


# Columns that rows were sealed without before there were any: they count where they say something,
# so that those rows go on to be told whole or damaged.
_LATER = frozenset({alarms.c.priority.name, alarms.c.suppressed_by.name})


def of_row(table: Table, values: Mapping[Any, Any]) -> str:
    """The checksum of a row: 8 hexadecimal digits of all columns that it is of; a finding has three
    of them, a part each.
    """
    return "".join(_crc(_counted(values, part)) for part in _parts(table))


def _counted(values: Mapping[Any, Any], part: Sequence[str]) -> list[Any]:
    """What a part of a row's checksum is of."""
    first = [values.get(name) for name in part if name not in _LATER]
    later = [[name, values.get(name)] for name in part if name in _LATER]
    return first + [[name, value] for name, value in later if value is not None]


def differs(table: Table, values: Mapping[Any, Any]) -> bool:
    """Whether a row, as far as its parts were read, differs from its checksum.

    One without any does: the end of a row is lost by a flip in its head.
    """
    checksum = values[_own(table)] or ""
    # A history reads no reason and no evidence: their parts are not judged then.
    read = ((k, part) for k, part in enumerate(_parts(table)) if part[0] in values)
    return any(_crc(_counted(values, part)) != checksum[8 * k : 8 * k + 8] for k, part in read)


def sealed(table: Table, values: Mapping[str, Any]) -> dict[str, Any]:
    """The values of a new row, with its checksum."""
    return {**values, _own(table): of_row(table, values)}


def change(
    connection: Connection,
    table: Table,
    key: Any,
    changes: Callable[[Mapping[Any, Any]], dict[str, Any]],
) -> Row[Any]:
    """Change the row of a key by what it was, and its checksum; one that differs from it goes on
    doing so. Gives the new row.

    The row is held from before it is read until the transaction ends: nobody changes it between its
    values and their checksum.
    """
    of_key = table.c.id == key
    before = connection.execute(select(table).where(of_key).with_for_update()).one()._mapping
    new = changes(before)
    # A row that was damaged must not become whole by a change of another column.
    if not differs(table, before):
        new[_own(table)] = of_row(table, {**before, **new})
    return connection.execute(update(table).where(of_key).values(new).returning(table)).one()


def labelled(table: Table) -> list[Label[Any]]:
    """All columns of a table that is joined to another, under names that are no other's:
    `of_labelled` takes them back.
    """
    return [column.label(f"{table.name}_{column.name}") for column in table.columns]


def of_labelled(table: Table, row: Row[Any]) -> dict[str, Any]:
    """The columns of a table in a row that was asked for with `labelled`."""
    return {column.name: row._mapping[f"{table.name}_{column.name}"] for column in table.columns}


def refuse(subject: str) -> StorageUnavailable:
    """That something cannot be answered with."""
    return StorageUnavailable(f"database: {subject}: {TELLS}")


def _own(table: Table) -> str:
    return "row_checksum" if "row_checksum" in table.columns else "checksum"


@cache
def _parts(table: Table) -> tuple[tuple[str, ...], ...]:
    """The columns that the parts of a row's checksum are of."""
    return (
        _PARTS_OF_FINDING
        if table is findings
        else (tuple(c.name for c in table.columns if _counts(table, c)),)
    )


def _counts(table: Table, column: Column[Any]) -> bool:
    """Not a number that the database gives, which an index of ours or a constraint holds; nor a
    file with a checksum of its own; nor the moment at which signals are let go, many at once, by
    which a window is found.
    """
    apart = (_own(table), windows.c.signal_let_go_at.name)
    return (
        column is not table.autoincrement_column
        and column.name not in apart
        and not isinstance(column.type, LargeBinary)
    )


def seal_rows_of_old(connection: Connection, revision: str) -> None:
    """Give each row its checksum that a schema of this revision kept without, as it is now."""
    # By the row's key, one at a time: rows of versions hold whole files.
    for table in (table for table, (since, _) in SEALED.items() if revision < since):
        own, numbers = table.c[_own(table)], list(table.primary_key)
        for key in connection.execute(select(*numbers).where(own.is_(None))).all():
            of_key = [column == value for column, value in zip(numbers, key, strict=True)]
            row = connection.execute(select(table).where(*of_key)).one()
            connection.execute(
                update(table).where(*of_key).values({own: of_row(table, row._mapping)})
            )


def plain(value: Any) -> Any:
    """The value as either database gives it back: a document of PostgreSQL tells 1.0 and 1 alike,
    and 0.0 and −0.0.
    """
    if isinstance(value, datetime):
        return value.astimezone(UTC).isoformat()
    # A flip in the declared type of a column (FLOAT to FLOZT) lets SQLite give 22 for 22.0: both
    # are the same value here.
    if isinstance(value, int | float) and not isinstance(value, bool):
        # Adding 0.0 makes 0.0 of −0.0. Beyond double range a whole number is told as it is written.
        return repr(float(value) + 0.0) if abs(value) < 1e300 else str(value)
    if isinstance(value, Mapping):
        return {str(name): plain(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    return value


def _crc(values: Sequence[Any]) -> str:
    return f"{zlib.crc32(orjson.dumps(plain(values), option=orjson.OPT_SORT_KEYS)):08x}"


_AT_ONCE = 1000
_DOCUMENTS = ("indicators", "thresholds", "units", "evidence")


@dataclass(frozen=True)
class RowCheck:
    """How many rows were looked at, and what is wrong with some of them, a line each."""

    rows: int
    wrong: list[str]


def check_rows(connection: Connection, pause: float = 0.0) -> RowCheck:
    """Look at every row that has a checksum; nothing is changed. `pause` [s] after every thousand
    of them.

    Beside the checksum only what holds for all of them at any moment is asked: each window has its
    finding and plausible numbers, each finding can be read and is of its window's asset, each asset
    points to its newest finding, each alarm's state is that of its newest entry in the journal,
    each model's versions are whole and counted.

    Raises ValueError for a row that the database's driver cannot read, which names no row.
    """
    wrong: list[str] = []
    rows = 0
    for table, (_, name) in SEALED.items():
        query, ask = _MORE.get(table, (select(table), None))
        at_once = 1 if table is model_versions else _AT_ONCE  # they hold whole files
        for row in connection.execute(query.execution_options(yield_per=at_once)):
            rows += 1
            if rows % _AT_ONCE == 0:
                time.sleep(pause)
            says = list(ask(row)) if ask else []
            if differs(table, row._mapping):
                says.append("its row differs from its checksum")
            wrong += (f"{name.format_map(row._mapping)}: {remark}" for remark in says)
    return RowCheck(rows, wrong)


Says = Iterator[str]


def _window(row: Row[Any]) -> Says:
    if not row.judged:
        yield "has no finding"
    if not (row.n > 0 and math.isfinite(row.sample_time) and row.sample_time > 0):
        yield f"has {row.n} samples every {row.sample_time} s"
    elif not isinstance(row.units, dict) or row.size_bytes < row.n * len(row.units):
        yield f"{row.size_bytes} bytes cannot hold {row.n} samples of its signals"


def _finding(row: Row[Any]) -> Says:
    if row.asset_id != row.of:
        yield f"its window {row.window_id} is of {row.of!r}"
    if row.verdict not in list(Verdict):
        yield f"its verdict is {row.verdict!r}"
    broken = [name for name in _DOCUMENTS if not isinstance(getattr(row, name), dict)]
    if broken:
        yield f"its {broken[0]} are no object of names to values"


def _asset(row: Row[Any]) -> Says:
    if row.last_finding_id != row.newest:
        yield f"its latest finding is said to be {row.last_finding_id} and is {row.newest}"
    if row.windows < row.held:
        yield f"counts {row.windows} windows and has {row.held}"


def _alarm(row: Row[Any]) -> Says:
    if row.state not in list(AlarmState):
        yield f"its state is {row.state!r}"
    elif row.written is not None and row.written != row.state:
        yield f"is {row.state}, and its journal ends with {row.written}"


def _model(row: Row[Any]) -> Says:
    if not (row.held == row.last_number == row.newest):
        yield f"has {row.held} versions and counts {row.last_number}"


def _version(row: Row[Any]) -> Says:
    if (
        len(row.content) != row.size_bytes
        or hashlib.sha256(row.content).hexdigest() != row.checksum
    ):
        yield "its content differs from its checksum"


def _of_each(row: Table, says: ColumnElement[Any], where: ColumnElement[bool]) -> ScalarSelect[Any]:
    """What the rows of another table come to that belong to a row."""
    return select(says).where(where).correlate(row).scalar_subquery()


_judged = _of_each(windows, func.count(findings.c.id), findings.c.window_id == windows.c.id)
_windows_held = _of_each(assets, func.count(windows.c.id), windows.c.asset_id == assets.c.id)
_newest_finding = _of_each(assets, func.max(findings.c.id), findings.c.asset_id == assets.c.id)
_newest_entry = _of_each(
    alarms, func.max(alarm_journal.c.id), alarm_journal.c.alarm_id == alarms.c.id
)
_versions_held = _of_each(
    models, func.count(model_versions.c.number), model_versions.c.model_id == models.c.id
)
_newest_version = _of_each(
    models,
    func.coalesce(func.max(model_versions.c.number), 0),
    model_versions.c.model_id == models.c.id,
)
# What is asked of a row of some tables beside its checksum, and the query that answers it.
_MORE: Mapping[Table, tuple[Select[Any], Callable[[Row[Any]], Says]]] = {
    windows: (select(windows, _judged.label("judged")), _window),
    findings: (
        select(findings, windows.c.asset_id.label("of")).join_from(
            findings, windows, windows.c.id == findings.c.window_id
        ),
        _finding,
    ),
    assets: (select(assets, _newest_finding.label("newest"), _windows_held.label("held")), _asset),
    alarms: (
        select(alarms, alarm_journal.c.state.label("written")).join_from(
            alarms, alarm_journal, alarm_journal.c.id == _newest_entry, isouter=True
        ),
        _alarm,
    ),
    models: (select(models, _newest_version.label("newest"), _versions_held.label("held")), _model),
    model_versions: (select(model_versions), _version),
}
