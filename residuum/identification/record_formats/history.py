"""Histories of plants: what their addresses name, and what is asked of each kind.

`SCHEME://user@host/database/table?tags=speed,torque&start=2026-03-01&end=2026-03-08` names rows of
times and values. `&window=600` are the windows of so many seconds in that time, and `&each=pump`
those of each value of a column, which `rescore` and `reidentify` take one by one. No message
repeats a password.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any, Protocol
from urllib.parse import SplitResult, parse_qsl, unquote, urlencode, urlsplit

from residuum.identification.errors import BadRecord
from residuum.identification.record import Record
from residuum.identification.record_formats.options import ReadOptions
from residuum.nearest_names import known_names

# one slash is enough: a `Path` made of an address keeps one of its two
_ADDRESS = re.compile(r"([\w.]+):/+(.+)", re.DOTALL)
ROLES = ("time", "tag", "value")
"""Columns that an address may name where they are not clear."""
OPCUA = "opc.tcp"
"""The scheme of servers that keep the history of nodes; those of others are of tables."""
_KEYS_OF_NODES = ("nodes", "start", "end", "window")


class HistoryAway(BadRecord):
    """The server of a history does not answer, which says nothing of its records."""


@dataclass(frozen=True)
class Address:
    """A table, what of it is asked for, and where columns have no usual names, these; of an OPC UA
    server its nodes as tags.

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
        tags = "nodes" if self.scheme == OPCUA else "tags"
        asked = {tags: ",".join(self.tags)} if self.tags else {}
        asked |= {**self.columns, **self.where}
        ends = {"start": self.start, "end": self.end}
        asked |= {key: _written(instant) for key, instant in ends.items() if instant is not None}
        return f"{self.shown}?{urlencode(asked, safe=',:')}" if asked else self.shown


def is_address_of(path: object, schemes: Sequence[str]) -> bool:
    """Whether this is an address of one of these schemes."""
    return split_address(str(path), schemes) is not None


def split_address(text: str, schemes: Sequence[str]) -> SplitResult | None:
    """Scheme, server, path and query of an address; None where it has none of these schemes."""
    matched = _ADDRESS.fullmatch(text)
    if matched is None or matched[1].lower() not in schemes:
        return None
    return urlsplit(f"{matched[1].lower()}://{matched[2]}")


def parse_address(text: str, schemes: Sequence[str]) -> Address:
    """The table that an address of one of these schemes names.

    >>> text = "timescale://me:secret@plant/pumps/public.readings?tags=q,p&start=2026-03-01&site=north"
    >>> at = parse_address(text, ["timescale"])
    >>> at.shown, at.table, at.tags, at.where
    ('timescale://me@plant/pumps/public.readings', ('public', 'readings'), ('q', 'p'), {'site': 'north'})
    >>> text = "opc.tcp://me:secret@plant:4840/x?nodes=ns=2;s=Speed,i=85&start=2026-03-01&end=2026-03-02"
    >>> at = parse_address(text, ["opc.tcp"])
    >>> at.shown, at.tags
    ('opc.tcp://plant:4840/x', ('ns=2;s=Speed', 'i=85'))

    Raises
    ------
    BadRecord
        No database and table in it, or no nodes of a server, or a key that these have not; a start
        or end that is no date.
    """
    parts = split_address(text, schemes)
    if parts is None:
        raise BadRecord(f"{text}: is no address of a history")
    if parts.scheme == OPCUA:
        return _nodes_of(parts)
    shown, server, table = _table_of(parts)
    asked = dict(parse_qsl(parts.query, keep_blank_values=True))
    return Address(
        scheme=parts.scheme,
        shown=shown,
        server=server,
        table=table,
        tags=listed(asked.pop("tags", "")),
        start=instant_of(asked.pop("start", ""), "start", shown),
        end=instant_of(asked.pop("end", ""), "end", shown),
        columns={role: asked.pop(role) for role in ROLES if role in asked},
        window=_window_length(asked.pop("window", ""), shown),
        each=asked.pop("each", None),
        # what remains: a key without a meaning of its own chooses rows by a column of its name
        where=asked,
    )


def _table_of(parts: SplitResult) -> tuple[str, dict[str, Any], tuple[str, ...]]:
    """(address without password and query, what a connection takes, parts of the table's name)."""
    host = parts.hostname or ""
    try:
        port = parts.port
    except ValueError:
        raise BadRecord(f"{parts.scheme}://{host}: its port is no number") from None
    # The password stays out of what refusals and records show.
    user = f"{parts.username}@" if parts.username else ""
    shown = f"{parts.scheme}://{user}{host}{f':{port}' if port else ''}{parts.path}"
    names = [unquote(name) for name in parts.path.split("/") if name]
    if len(names) != 2:
        raise BadRecord(
            f"{shown}: must name a database and a table,"
            f" {parts.scheme}://host/database/table?tags=a,b"
        )
    database, table = names
    server = {
        "host": parts.hostname,
        "port": port,
        "user": parts.username and unquote(parts.username),
        "password": parts.password and unquote(parts.password),
        "dbname": database,
    }
    return shown, server, tuple(table.split("."))


def _nodes_of(parts: SplitResult) -> Address:
    shown = f"{parts.scheme}://{parts.netloc.rpartition('@')[2]}{parts.path}"
    asked = dict(parse_qsl(parts.query, keep_blank_values=True))
    for key in asked:
        if key not in _KEYS_OF_NODES:
            raise BadRecord(f"{shown}: no key {key!r}; {known_names(key, _KEYS_OF_NODES)}")
    nodes = listed(asked.get("nodes", ""))
    if not nodes:
        raise BadRecord(f"{shown}: name the nodes to read, ?nodes=ns=2;s=Speed,ns=2;s=Torque")
    start, end = (instant_of(asked.get(key, ""), key, shown) for key in ("start", "end"))
    if start is None or end is None:
        raise BadRecord(f"{shown}: say from when to when, &start=2026-03-01&end=2026-03-08")
    server = {
        "user": parts.username and unquote(parts.username),
        "password": parts.password and unquote(parts.password),
    }
    window = _window_length(asked.get("window", ""), shown)
    return Address(parts.scheme, shown, server, (), nodes, start, end, window=window)


def listed(text: str) -> tuple[str, ...]:
    """The names of a list that commas part."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _window_length(text: str, shown: str) -> timedelta | None:
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
            f"{shown}: {key} is {text!r}; must be a date or an instant, as"
            " 2026-03-01T06:00:00+01:00"
        ) from None
    return instant if instant.tzinfo else instant.replace(tzinfo=UTC)


class History(Protocol):
    """A server of histories, asked for one address after another; it may keep a connection.

    Each raises HistoryAway where the server does not answer, and BadRecord where it refuses, or has
    not what the address names.
    """

    def span(self, at: Address) -> tuple[datetime, datetime] | None:
        """The instants of the first and the last row of an address; None where it has none."""

    def values_of(self, at: Address, column: str) -> list[str]:
        """What a column that tells rows apart holds."""

    def record(self, at: Address, options: ReadOptions) -> Record:
        """The tags of an address on one even time base, from `start` to before `end`."""

    def close(self) -> None:
        """Let go of the connection."""
