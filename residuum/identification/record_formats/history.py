"""Records from a plant's history in PostgreSQL or TimescaleDB, by the address of a table.

`timescale://user@host/database/table?tags=speed,torque&start=2026-03-01&end=2026-03-08` names rows of
times and values. A *wide* table has a column for each tag, a *long* one a row for each value with
the tag's name in a column of texts. `&window=600` are the windows of so many seconds in that time,
and `&each=pump` those of each value of a column, which `rescore` and `reidentify` take one by one.
Rows come by COPY in binary form, in which every row of times
and numbers has the same length, so that a block of them is an array as it stands.

The connection only reads. A password stands in the address, in PGPASSWORD or in a password file;
no message repeats it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from importlib import import_module
from itertools import islice
from typing import Any
from urllib.parse import parse_qsl, unquote, urlencode, urlsplit

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.errors import BadRecord, in_one_line
from residuum.identification.record import Record
from residuum.identification.record_formats.loggers.logger_head import is_unit, unit_of_head
from residuum.identification.record_formats.optional_package import need
from residuum.identification.record_formats.options import ReadOptions
from residuum.identification.record_formats.time_bases import TimedChannel, on_one_base
from residuum.nearest_names import known_names

_SCHEMES = ("timescale", "postgresql", "postgres")
_ADDRESS = re.compile(r"(\w+):/+(.+)", re.DOTALL)
"""A path, which some have made of the address before, keeps one of its two slashes."""
_OF_TIME = ("timestamptz", "timestamp", "date")
_OF_NUMBERS = ("float4", "float8", "int2", "int4", "int8", "numeric", "bool")
_OF_TEXT = ("text", "varchar", "bpchar", "name")
_USUAL = {
    "time": ("time", "ts", "timestamp", "datetime", "bucket"),
    "tag": ("tag", "name", "signal", "channel", "tag_name", "metric", "item", "point"),
    "value": ("value", "val", "reading"),
}
"""Names by which a column is known for what it holds, where several could be."""
_EPOCH = 946_684_800.0
"""Seconds from 1970 to 2000, from which PostgreSQL counts microseconds."""
_HEADER, _BLOCK = 19, 1 << 10
"""Bytes before the first row of a binary COPY; rows that are turned into numbers at a time."""
_LISTED = 12
_MOST_WINDOWS = 10_000_000
_PATIENCE = 10
"""Seconds until a server that does not answer is given up."""


@dataclass(frozen=True)
class Address:
    """A table, what of it is asked for, and where columns have no usual names, these.

    `shown` is the table's address as messages repeat it. `where` holds other columns with the value
    that rows must have there; `window` and `each` ask for several records in place of one.
    """

    scheme: str
    shown: str
    server: Mapping[str, Any]
    table: tuple[str, ...]
    tags: tuple[str, ...] = ()
    start: datetime | None = None
    end: datetime | None = None
    columns: Mapping[str, str] = field(default_factory=dict)
    where: Mapping[str, str] = field(default_factory=dict)
    window: timedelta | None = None
    each: str | None = None

    @property
    def without_secret(self) -> str:
        """The whole address, but for the password."""
        asked = {"tags": ",".join(self.tags)} if self.tags else {}
        asked |= {**self.columns, **self.where}
        ends = {"start": self.start, "end": self.end}
        asked |= {key: _written(instant) for key, instant in ends.items() if instant is not None}
        return f"{self.shown}?{urlencode(asked, safe=',:')}" if asked else self.shown


def is_history(path: object) -> bool:
    """Whether this names a table of a history rather than a file."""
    return is_address_of(path, _SCHEMES)


def is_address_of(path: object, schemes: Sequence[str]) -> bool:
    """Whether this is an address of one of these schemes."""
    matched = _ADDRESS.fullmatch(str(path))
    return matched is not None and matched[1].lower() in schemes


def parse_address(text: str, schemes: Sequence[str] = _SCHEMES) -> Address:
    """The table that an address of one of these schemes names.

    >>> at = parse_address("timescale://me:secret@plant/pumps/public.readings?tags=q,p&start=2026-03-01&site=north")
    >>> at.shown, at.table, at.tags, at.where
    ('timescale://me@plant/pumps/public.readings', ('public', 'readings'), ('q', 'p'), {'site': 'north'})

    Raises
    ------
    BadRecord
        No database and table in it; a start or end that is no date.
    """
    matched = _ADDRESS.fullmatch(text)
    if matched is None or matched[1].lower() not in schemes:
        raise BadRecord(f"{text}: is no address of a history")
    scheme, rest = matched[1].lower(), matched[2]
    parts = urlsplit(f"{scheme}://{rest}")
    user = f"{parts.username}@" if parts.username else ""
    place = parts.hostname or ""
    try:
        port = parts.port
    except ValueError:
        raise BadRecord(f"{scheme}://{place}: its port is no number") from None
    shown = f"{scheme}://{user}{place}{f':{port}' if port else ''}{parts.path}"
    names = [unquote(name) for name in parts.path.split("/") if name]
    if len(names) != 2:
        raise BadRecord(
            f"{shown}: must name a database and a table, {scheme}://host/database/table?tags=a,b"
        )
    server = {
        "host": parts.hostname,
        "port": port,
        "user": parts.username and unquote(parts.username),
        "password": parts.password and unquote(parts.password),
        "dbname": names[0],
    }
    asked = dict(parse_qsl(parts.query, keep_blank_values=True))
    tags = tuple(tag.strip() for tag in asked.pop("tags", "").split(",") if tag.strip())
    start, end = (instant_of(asked.pop(key, ""), key, shown) for key in ("start", "end"))
    columns = {role: asked.pop(role) for role in _USUAL if role in asked}
    table = tuple(names[1].split("."))
    window, each = _length(asked.pop("window", ""), shown), asked.pop("each", None)
    return Address(scheme, shown, server, table, tags, start, end, columns, asked, window, each)


def _length(text: str, shown: str) -> timedelta | None:
    if not text:
        return None
    try:
        window = timedelta(seconds=float(text))
    except (ValueError, OverflowError):
        window = timedelta(0)
    if window <= timedelta(0):
        raise BadRecord(f"{shown}: window is {text!r}; must be a number of seconds above 0")
    return window


def _written(instant: datetime) -> str:
    return instant.astimezone(UTC).isoformat().replace("+00:00", "Z")


def instant_of(text: str, key: str, shown: str) -> datetime | None:
    """An instant of an address, of UTC where no zone is said; None where none is."""
    if not text:
        return None
    try:
        instant = datetime.fromisoformat(text)
    except ValueError:
        raise BadRecord(
            f"{shown}: {key} is {text!r}; must be a date or an instant, as 2026-03-01T06:00:00+01:00"
        ) from None
    return instant if instant.tzinfo else instant.replace(tzinfo=UTC)


def read_history(address: str, options: ReadOptions = ReadOptions()) -> Record:
    """The record of an address: its tags on one even time base, from `start` to before `end`.

    The unit of a tag is that of its column's name, `speed [rpm]`, or its comment; in a long table
    that of a column `unit`. Times without a zone are taken as UTC.

    Raises
    ------
    BadRecord
        A server that does not answer or refuses, no such table, column or tag, no rows; as
        `on_one_base` for times that do not lie on one base; windows, which are several records.
    """
    at = parse_address(address)
    if at.window or at.each:
        asked = "window" if at.window else "each"
        raise BadRecord(
            f"{at.shown}: {asked} asks for several records; leave it out, or give the address to"
            " `residuum rescore` or `residuum reidentify`"
        )
    with _connected(at) as connection:
        return _record(connection, at, options)


@contextmanager
def _connected(at: Address) -> Iterator[Any]:
    """A connection that only reads; the server's errors are told without the password."""
    psycopg = need("psycopg", at.shown, "postgres")
    try:
        with _connection(psycopg, at) as connection:
            yield connection
    except psycopg.Error as error:
        raise BadRecord(f"{at.shown}: {_without_secret(in_one_line(error), at)}") from None


def _connection(psycopg: Any, at: Address) -> Any:
    return psycopg.connect(
        **{key: value for key, value in at.server.items() if value is not None},
        connect_timeout=_PATIENCE,
        options="-c default_transaction_read_only=on -c timezone=UTC",
    )


def _record(connection: Any, at: Address, options: ReadOptions) -> Record:
    channels = _channels(connection, at, _table_of(connection, at))
    if not len(channels[0].time):
        raise BadRecord(f"{at.shown}: no rows in that time")
    return on_one_base(channels, at.shown, options)


def windows_of(address: str) -> list[str]:
    """The addresses of the windows in `start` … `end`, or in all that the table holds, for each
    value of the column `each` where one is named; without a password. The last window may be
    shorter.

    Raises
    ------
    BadRecord
        As `read_history`; no window's length; more than ten million windows.
    """
    at = parse_address(address)
    if at.window is None:
        raise BadRecord(f"{at.shown}: say how long a window is, in seconds: &window=600")
    with _connected(at) as connection:
        columns = _table_of(connection, at)
        time = _column(at, columns, "time", _OF_TIME)
        start, end = _span(connection, at, time)
        machines: list[Mapping[str, str]] = [{}]
        if at.each is not None:
            if at.each not in columns:
                raise BadRecord(
                    f"{at.shown}: no column {at.each!r} to part rows by;"
                    f" {known_names(at.each, columns, 'there are')}"
                )
            machines = [{at.each: value} for value in _values_of(connection, at, time, at.each)]
    count = -((start - end) // at.window)
    if count * len(machines) > _MOST_WINDOWS:
        raise BadRecord(
            f"{at.shown}: holds {count * len(machines)} windows; at most {_MOST_WINDOWS}. Say a"
            " longer window, or a shorter time by start and end"
        )
    starts = [start + k * at.window for k in range(count)]
    return [
        replace(
            at,
            where={**at.where, **machine},
            start=begin,
            end=min(begin + at.window, end),
            window=None,
            each=None,
        ).without_secret
        for machine in machines
        for begin in starts
    ]


def _span(connection: Any, at: Address, time: str) -> tuple[datetime, datetime]:
    """From when to when windows are cut: as asked, else from the first to the last row."""
    if at.start is not None and at.end is not None:
        return at.start, at.end
    sql = import_module("psycopg.sql")
    query = sql.SQL(
        "SELECT min({time}::timestamptz), max({time}::timestamptz) FROM {table} WHERE {rows}"
    ).format(
        time=sql.Identifier(time),
        table=sql.Identifier(*at.table),
        rows=_conditions(at, time, {}),
    )
    first, last = connection.execute(query).fetchone()
    if first is None:
        raise BadRecord(f"{at.shown}: no rows in that time")
    return at.start or first, at.end or last + timedelta(microseconds=1)


def _values_of(connection: Any, at: Address, time: str, column: str) -> list[str]:
    sql = import_module("psycopg.sql")
    query = sql.SQL("SELECT DISTINCT {}::text FROM {} WHERE {} ORDER BY 1").format(
        sql.Identifier(column), sql.Identifier(*at.table), _conditions(at, time, {})
    )
    return [value for (value,) in connection.execute(query) if value is not None]


class HistoryReader:
    """Windows of one history, read one by one over a connection that stays open.

    Parameters
    ----------
    address : str
        Of the history, with its password where it needs one.
    """

    def __init__(self, address: str) -> None:
        self._server = parse_address(address).server
        self._connection: Any = None

    def read(self, window: str) -> Record:
        """The record of a window's address, as `windows_of` gives it.

        Raises
        ------
        BadRecord
            As `read_history`.
        HistoryAway
            The server does not answer, now and when it is asked anew.
        """
        at = replace(parse_address(window), server=self._server)
        psycopg = need("psycopg", at.shown, "postgres")
        try:
            return self._read(psycopg, at)
        except psycopg.OperationalError:
            self.close()  # the server closed the connection, or began anew
        try:
            return self._read(psycopg, at)
        except psycopg.OperationalError as error:
            raise HistoryAway(f"{at.shown}: {_without_secret(in_one_line(error), at)}") from None

    def close(self) -> None:
        """Let go of the connection; the next read opens another."""
        if self._connection is not None:
            self._connection.close()
        self._connection = None

    def _read(self, psycopg: Any, at: Address) -> Record:
        if self._connection is None:
            self._connection = _connection(psycopg, at)
        try:
            with self._connection.transaction():
                record = _record(self._connection, at, ReadOptions())
        except psycopg.OperationalError:
            raise
        except psycopg.Error as error:
            raise BadRecord(f"{at.shown}: {_without_secret(in_one_line(error), at)}") from None
        return replace(record, source=at.without_secret)


class HistoryAway(Exception):
    """The server of a history does not answer, which says nothing of its records."""


def _without_secret(text: str, at: Address) -> str:
    secret = at.server.get("password")
    return text.replace(secret, "…") if secret else text


@dataclass(frozen=True)
class _Column:
    name: str
    kind: str
    comment: str


def _table_of(connection: Any, at: Address) -> dict[str, _Column]:
    """The columns of the table."""
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
    time = _column(at, columns, "time", _OF_TIME)
    free = [column for column in columns.values() if column.name not in at.where]
    numbers = [column.name for column in free if column.kind in _OF_NUMBERS]
    by_name = {unit_of_head(name)[0]: name for name in numbers} | {name: name for name in numbers}
    # rows of a long table are told apart by a column of texts; a wide one may have such, too
    if "tag" in at.columns or any(column.kind in _OF_TEXT for column in free):
        if not at.tags:
            tag = _column(at, columns, "tag", _OF_TEXT)
            raise BadRecord(
                f"{at.shown}: its rows are told apart by {tag!r}; name the tags, ?tags=a,b: there"
                f" are {', '.join(_tags(connection, at, tag))}"
            )
        if "tag" in at.columns or not set(at.tags) & by_name.keys():
            return _of_rows(connection, at, columns, time)
    return _of_columns(connection, at, columns, by_name)


def _of_columns(
    connection: Any, at: Address, columns: Mapping[str, _Column], by_name: Mapping[str, str]
) -> list[TimedChannel]:
    """The tags of a wide table: those that are named, else all columns of numbers."""
    all_of_them = dict.fromkeys(unit_of_head(name)[0] for name in by_name.values())
    wanted = at.tags or tuple(all_of_them)
    if not wanted:
        raise BadRecord(f"{at.shown}: has no column of numbers; there are {', '.join(columns)}")
    for tag in wanted:
        if tag not in by_name:
            raise BadRecord(
                f"{at.shown}: no column of numbers {tag!r}; {known_names(tag, by_name, 'there are')}"
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


def _of_rows(
    connection: Any, at: Address, columns: Mapping[str, _Column], time: str
) -> list[TimedChannel]:
    """The tags of a long table."""
    tag, value = _column(at, columns, "tag", _OF_TEXT), _column(at, columns, "value", _OF_NUMBERS)
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
        of_tag = "" if unit is None else _said_unit(connection, at, unit, time, {tag: name})
        channels.append(TimedChannel(name, of_tag, instants, values))
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


def _said_unit(connection: Any, at: Address, unit: str, time: str, where: Mapping[str, str]) -> str:
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
    parts = [
        sql.SQL("{}::text = {}").format(sql.Identifier(name), sql.Literal(value))
        for name, value in {**at.where, **where}.items()
    ]
    column = sql.Identifier(time)
    parts.append(sql.SQL("isfinite({})").format(column))
    parts += [
        sql.SQL("{}::timestamptz {} {}").format(column, sql.SQL(sign), sql.Literal(instant))
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
    """The rows of a binary COPY, so many at a time, as they arrive; two bytes end them."""
    waiting, begins = b"", _HEADER
    with connection.cursor() as cursor, cursor.copy(query) as copy:
        messages = iter(copy)
        while block := b"".join(islice(messages, _BLOCK)):
            waiting += block
            rows = max(len(waiting) - begins, 0) // layout.itemsize
            if rows:
                yield np.frombuffer(waiting, layout, rows, begins)
                waiting, begins = waiting[begins + rows * layout.itemsize :], 0
