"""Records from a plant's history in PostgreSQL or TimescaleDB.

A *wide* table has a column for each tag, a *long* one a row for each value with the tag's name in a
column of texts. Rows come by COPY in binary form, in which every row of times and numbers has the
same length, so that a block of them is an array as it stands.

The connection only reads. A password stands in the address, in PGPASSWORD or in a password file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from importlib import import_module
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.errors import BadRecord, in_one_line
from residuum.identification.record import Record
from residuum.identification.record_formats.history import Address, HistoryAway
from residuum.identification.record_formats.loggers.logger_head import is_unit, unit_of_head
from residuum.identification.record_formats.optional_package import need
from residuum.identification.record_formats.options import ReadOptions
from residuum.identification.record_formats.time_bases import TimedChannel, on_one_base
from residuum.nearest_names import known_names

Answer = TypeVar("Answer")
# types as `pg_type` calls them
_OF_TIME = ("timestamptz", "timestamp", "date")
_OF_NUMBERS = ("float4", "float8", "int2", "int4", "int8", "numeric", "bool")
_OF_TEXT = ("text", "varchar", "bpchar", "name")
# names by which a column is known for what it holds, where several could be
_USUAL = {
    "time": ("time", "ts", "timestamp", "datetime", "bucket"),
    "tag": ("tag", "name", "signal", "channel", "tag_name", "metric", "item", "point"),
    "value": ("value", "val", "reading"),
}
_EPOCH = 946_684_800.0  # [s] from 1970 to 2000, from which PostgreSQL counts microseconds
# bytes before the first row of a binary COPY: signature 11, flags 4, length of extensions 4
_HEADER = 19
_BLOCK = 1 << 18  # bytes of a COPY that are turned into numbers at a time
_LISTED = 12  # tags that a refusal lists
_PATIENCE = 10  # [s] until a server that does not answer is given up


class PostgresHistory:
    """A server of PostgreSQL, asked over a connection that stays open.

    The columns of a table are asked for once a connection, not with each of its windows.
    """

    def __init__(self) -> None:
        self._connection: Any = None
        self._columns: dict[str, dict[str, _Column]] = {}

    def close(self) -> None:
        """Let go of the connection and of what is known of tables; what is asked next opens
        another.
        """
        if self._connection is not None:
            self._connection.close()
        self._connection = None
        self._columns = {}

    def span(self, at: Address) -> tuple[datetime, datetime] | None:
        """The instants of the first and the last row."""
        return self._asked(at, lambda connection, columns: _span(connection, at, columns))

    def values_of(self, at: Address, column: str) -> list[str]:
        """What a column holds, in order; BadRecord where the table has none of this name."""
        return self._asked(
            at, lambda connection, columns: _values_of(connection, at, columns, column)
        )

    def record(self, at: Address, options: ReadOptions) -> Record:
        """The record of an address.

        The unit of a tag is that of its column's name, `speed [rpm]`, or its comment; in a long
        table that of a column `unit`. Times without a zone are taken as UTC.

        Raises
        ------
        BadRecord
            A server that refuses, no such table, column or tag, no rows; as `on_one_base` for times
            that do not lie on one base.
        HistoryAway
            A server that does not answer.
        """
        return self._asked(
            at, lambda connection, columns: _record(connection, at, columns, options)
        )

    def _asked(self, at: Address, ask: Callable[[Any, dict[str, _Column]], Answer]) -> Answer:
        """The answer to a question; a connection that the server closed is opened anew."""
        psycopg = need("psycopg", at.shown, "postgres")
        try:
            if self._connection is not None:
                try:
                    return self._answer(at, ask)
                except psycopg.OperationalError:
                    self.close()
            self._connection = psycopg.connect(
                **{key: value for key, value in at.server.items() if value is not None},
                connect_timeout=_PATIENCE,
                # stamps without a zone are taken as UTC; nothing here can write
                options="-c default_transaction_read_only=on -c timezone=UTC",
            )
            return self._answer(at, ask)
        except psycopg.Error as error:
            kind = HistoryAway if isinstance(error, psycopg.OperationalError) else BadRecord
            raise kind(f"{at.shown}: {_without_secret(in_one_line(error), at)}") from None

    def _answer(self, at: Address, ask: Callable[[Any, dict[str, _Column]], Answer]) -> Answer:
        # one transaction, so that columns, tags and rows are of one state of the database
        with self._connection.transaction():
            if at.shown not in self._columns:
                self._columns[at.shown] = _columns_of(self._connection, at)
            return ask(self._connection, self._columns[at.shown])


def _record(
    connection: Any, at: Address, columns: Mapping[str, _Column], options: ReadOptions
) -> Record:
    channels = _channels(connection, at, columns)
    if not len(channels[0].time):
        raise BadRecord(f"{at.shown}: no rows in that time")
    return on_one_base(channels, at.shown, options)


def _span(
    connection: Any, at: Address, columns: Mapping[str, _Column]
) -> tuple[datetime, datetime] | None:
    sql = import_module("psycopg.sql")
    time = _column(at, columns, "time", _OF_TIME)
    query = sql.SQL(
        "SELECT min({time})::timestamptz, max({time})::timestamptz FROM {table} WHERE {rows}"
    ).format(
        time=sql.Identifier(time),
        table=sql.Identifier(*at.table),
        rows=_conditions(at, time, {}),
    )
    first, last = connection.execute(query).fetchone()
    return None if first is None else (first, last)


def _values_of(
    connection: Any, at: Address, columns: Mapping[str, _Column], column: str
) -> list[str]:
    sql = import_module("psycopg.sql")
    if column not in columns:
        raise BadRecord(
            f"{at.shown}: no column {column!r} to part rows by;"
            f" {known_names(column, columns, 'there are')}"
        )
    time = _column(at, columns, "time", _OF_TIME)
    query = sql.SQL("SELECT DISTINCT {}::text FROM {} WHERE {} ORDER BY 1").format(
        sql.Identifier(column), sql.Identifier(*at.table), _conditions(at, time, {})
    )
    return [value for (value,) in connection.execute(query) if value is not None]


def _without_secret(text: str, at: Address) -> str:
    secret = at.server.get("password")
    return text.replace(secret, "…") if secret else text


@dataclass(frozen=True)
class _Column:
    name: str
    kind: str
    comment: str


def _columns_of(connection: Any, at: Address) -> dict[str, _Column]:
    """The columns of the table, by name."""
    sql = import_module("psycopg.sql")
    quoted = sql.Identifier(*at.table).as_string(connection)
    rows = connection.execute(
        "SELECT a.attname, t.typname, coalesce(col_description(a.attrelid, a.attnum), '')"
        " FROM pg_attribute a JOIN pg_type t ON t.oid = a.atttypid"
        " WHERE a.attrelid = to_regclass(%s) AND a.attnum > 0 AND NOT a.attisdropped"
        " ORDER BY a.attnum",
        (quoted,),
    ).fetchall()
    if not rows:
        known = connection.execute(
            "SELECT table_schema || '.' || table_name FROM information_schema.tables"
            " WHERE table_schema NOT LIKE 'pg\\_%' AND table_schema <> 'information_schema'"
            " AND table_schema NOT LIKE '\\_timescaledb%' ORDER BY 1"
        ).fetchall()
        names = [name.removeprefix("public.") for (name,) in known]
        table = ".".join(at.table)
        raise BadRecord(f"{at.shown}: no table {table!r}; {known_names(table, names, 'there are')}")
    return {name: _Column(name, kind, comment) for name, kind, comment in rows}


def _channels(connection: Any, at: Address, columns: Mapping[str, _Column]) -> list[TimedChannel]:
    for name in at.where:
        if name not in columns:
            raise BadRecord(
                f"{at.shown}: no column {name!r} to choose rows by;"
                f" {known_names(name, columns, 'there are')}"
            )
    free = [column for column in columns.values() if column.name not in at.where]
    numbers = [column.name for column in free if column.kind in _OF_NUMBERS]
    # a column is asked for by its name alone or, as in the table, with its unit
    by_name = {unit_of_head(name)[0]: name for name in numbers}
    by_name |= {name: name for name in numbers}
    if _is_long(at, free, by_name):
        return _of_rows(connection, at, columns)
    return _of_columns(connection, at, columns, by_name)


def _is_long(at: Address, free: Sequence[_Column], numbers: Mapping[str, str]) -> bool:
    """Whether the table is a long one, whose rows a column of texts tells apart.

    A wide table may have such a column, too: it is wide where a tag that is asked for names one of
    its columns of numbers.
    """
    if "tag" in at.columns:
        return True
    has_texts = any(column.kind in _OF_TEXT for column in free)
    return has_texts and numbers.keys().isdisjoint(at.tags)


def _of_columns(
    connection: Any, at: Address, columns: Mapping[str, _Column], by_name: Mapping[str, str]
) -> list[TimedChannel]:
    """The tags of a wide table: those that are named, else all columns of numbers."""
    all_tags = dict.fromkeys(unit_of_head(name)[0] for name in by_name.values())
    wanted = at.tags or tuple(all_tags)
    if not wanted:
        raise BadRecord(f"{at.shown}: has no column of numbers; there are {', '.join(columns)}")
    for tag in wanted:
        if tag not in by_name:
            raise BadRecord(
                f"{at.shown}: no column of numbers {tag!r};"
                f" {known_names(tag, by_name, 'there are')}"
            )
    chosen = [columns[by_name[tag]] for tag in wanted]
    time = _column(at, columns, "time", _OF_TIME)
    instants, values = _copied(connection, at, time, chosen, {})
    return [
        TimedChannel(tag, _unit(column), instants, row)
        for tag, column, row in zip(wanted, chosen, values, strict=True)
    ]


def _column(at: Address, columns: Mapping[str, _Column], role: str, kinds: Sequence[str]) -> str:
    """The column of a role: the one that is named, the only one of its kinds, or that of a usual
    name.
    """
    if role in at.columns:
        if at.columns[role] not in columns:
            raise BadRecord(
                f"{at.shown}: no column {at.columns[role]!r} for the {role};"
                f" {known_names(at.columns[role], columns, 'there are')}"
            )
        return at.columns[role]
    fitting = [c.name for c in columns.values() if c.kind in kinds and c.name not in at.where]
    usual = [name for name in fitting if name.lower() in _USUAL[role]]
    if len(usual or fitting) == 1:
        return (usual or fitting)[0]
    listed = ", ".join(fitting) or "none"
    raise BadRecord(
        f"{at.shown}: which column holds the {role} is not clear (there are {listed}); say"
        f" ?{role}=COLUMN"
    )


def _of_rows(connection: Any, at: Address, columns: Mapping[str, _Column]) -> list[TimedChannel]:
    """The tags of a long table."""
    tag = _column(at, columns, "tag", _OF_TEXT)
    if not at.tags:
        raise BadRecord(
            f"{at.shown}: its rows are told apart by {tag!r}; name the tags, ?tags=a,b: there are"
            f" {', '.join(_tags(connection, at, tag))}"
        )
    time, value = _column(at, columns, "time", _OF_TIME), _column(at, columns, "value", _OF_NUMBERS)
    unit = next((c.name for c in columns.values() if c.name.lower() in ("unit", "units")), None)
    channels = []
    for name in at.tags:
        instants, (values,) = _copied(connection, at, time, [columns[value]], {tag: name})
        if not len(instants):
            known = _tags(connection, at, tag)
            raise BadRecord(
                f"{at.shown}: no rows of tag {name!r} in that time;"
                f" {known_names(name, known, 'there are')}"
            )
        own_unit = "" if unit is None else _unit_in_rows(connection, at, unit, time, {tag: name})
        channels.append(TimedChannel(name, own_unit, instants, values))
    return channels


def _unit(column: _Column) -> str:
    own = unit_of_head(column.name)[1]
    return own or (column.comment.strip() if is_unit(column.comment.strip()) else "")


def _tags(connection: Any, at: Address, tag: str) -> list[str]:
    sql = import_module("psycopg.sql")
    query = sql.SQL("SELECT DISTINCT {} FROM {} LIMIT {}").format(
        sql.Identifier(tag), sql.Identifier(*at.table), sql.Literal(_LISTED)
    )
    return sorted(str(name) for (name,) in connection.execute(query) if name is not None)


def _unit_in_rows(
    connection: Any, at: Address, unit: str, time: str, where: Mapping[str, str]
) -> str:
    """What stands in the column of units in all these rows."""
    sql = import_module("psycopg.sql")
    query = sql.SQL("SELECT DISTINCT {unit} FROM {table} WHERE {rows} AND {unit} <> '' LIMIT 2")
    named = {"unit": sql.Identifier(unit), "table": sql.Identifier(*at.table)}
    units = connection.execute(query.format(**named, rows=_conditions(at, time, where))).fetchall()
    if len(units) > 1:
        (tag,) = where.values()
        raise BadRecord(
            f"{at.shown}: tag {tag!r} is in {units[0][0]!r} and in {units[1][0]!r} within that"
            " time; read it in parts, by start and end"
        )
    return str(units[0][0]) if units else ""


def _conditions(at: Address, time: str, where: Mapping[str, str]) -> Any:
    sql = import_module("psycopg.sql")
    # columns as they stand, so that their indices are used: the words take the columns' types
    parts = [
        sql.SQL("{} = {}").format(sql.Identifier(name), sql.Literal(value))
        for name, value in {**at.where, **where}.items()
    ]
    column = sql.Identifier(time)
    # PostgreSQL has the instants 'infinity' and '-infinity', which no time base holds
    parts.append(sql.SQL("isfinite({})").format(column))
    parts += [
        sql.SQL("{} {} {}").format(column, sql.SQL(sign), sql.Literal(instant))
        for sign, instant in ((">=", at.start), ("<", at.end))
        if instant is not None
    ]
    return sql.SQL(" AND ").join(parts)


def _copied(
    connection: Any,
    at: Address,
    time: str,
    columns: Sequence[_Column],
    where: Mapping[str, str],
) -> tuple[FloatArray, FloatArray]:
    """(instants [s since 1970], values (columns, n)) of the rows, in order of time; NaN where there
    is no value.
    """
    sql = import_module("psycopg.sql")
    # NULL as NaN, so that every row has the same length; a bool becomes a float by way of an int
    values = [
        sql.SQL("coalesce({}{}::float8, 'NaN')").format(
            sql.Identifier(column.name), sql.SQL("::int" if column.kind == "bool" else "")
        )
        for column in columns
    ]
    query = sql.SQL(
        "COPY (SELECT {time}::timestamptz, {values} FROM {table} WHERE {where} ORDER BY {time})"
        " TO STDOUT (FORMAT binary)"
    ).format(
        time=sql.Identifier(time),
        values=sql.SQL(", ").join(values),
        table=sql.Identifier(*at.table),
        where=_conditions(at, time, where),
    )
    # a row: number of its fields, then of each its length in bytes and its value, big-endian
    fields = [("fields", ">i2"), ("long", ">i4"), ("time", ">i8")]
    for k in range(len(columns)):
        fields += [(f"long{k}", ">i4"), (f"value{k}", ">f8")]
    layout = np.dtype(fields)
    blocks = [_numbers(rows, len(columns)) for rows in _rows(connection, query, layout)]
    table = np.concatenate(blocks, axis=1) if blocks else np.empty((1 + len(columns), 0))
    return table[0], table[1:]


def _numbers(rows: npt.NDArray[Any], columns: int) -> FloatArray:
    """Instants [s] and values of rows, shape (1 + columns, n)."""
    table = np.empty((1 + columns, len(rows)))
    table[0] = _EPOCH + 1e-6 * rows["time"]
    for k in range(columns):
        table[1 + k] = rows[f"value{k}"]
    return table


def _rows(connection: Any, query: Any, layout: np.dtype[Any]) -> Iterator[npt.NDArray[Any]]:
    """The rows of a binary COPY, so many at a time, as they arrive."""
    unread, begins = b"", _HEADER
    with connection.cursor() as cursor, cursor.copy(query) as copy:
        for block in _blocks(copy):
            unread += block
            # messages need not end with a row, and two bytes that are none end the last one
            rows = max(len(unread) - begins, 0) // layout.itemsize
            if rows:
                yield np.frombuffer(unread, layout, rows, begins)
                unread, begins = unread[begins + rows * layout.itemsize :], 0


def _blocks(messages: Iterable[bytes]) -> Iterator[bytes]:
    """Messages, a row each, joined to blocks."""
    # added one by one: a list of them, kept until it is joined, costs half as much time again
    block = bytearray()
    for message in messages:
        block += message
        if len(block) >= _BLOCK:
            yield bytes(block)
            block.clear()
    yield bytes(block)
