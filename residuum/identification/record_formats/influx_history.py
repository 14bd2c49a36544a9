"""Records from InfluxDB, by the address of a measurement.

`influx://user@host:8086/database/measurement?tags=speed,torque&start=2026-03-01&end=2026-03-08&site=north`
names fields of a measurement; other keys are Influx's own tags, with the values that rows must
have. Rows are asked for by InfluxQL over HTTP, which the versions 1, 2 and 3 answer; `influxs` asks
by HTTPS. A token stands in INFLUX_TOKEN, a password in the address or in INFLUX_PASSWORD; no
message repeats either.
"""

from __future__ import annotations

import base64
import json
import os
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime, timedelta
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.parse import urlencode
from urllib.request import Request, urlopen

import numpy as np
import orjson

from residuum.array_types import FloatArray
from residuum.identification.errors import BadRecord, in_one_line
from residuum.identification.record import Record
from residuum.identification.record_formats.history import Address, HistoryAway
from residuum.identification.record_formats.loggers.logger_head import unit_of_head
from residuum.identification.record_formats.options import ReadOptions
from residuum.identification.record_formats.time_bases import TimedChannel, on_one_base
from residuum.nearest_names import known_names

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_PORT = 8086  # on which InfluxDB listens where nothing else is set
_CHUNK = 10_000  # rows that the server sends at a time; bytes that are read of a refusal
_PATIENCE = 60  # [s] until a server that does not answer is given up
_LISTED = 6  # sources that a refusal lists
# types of fields whose values are numbers; "string" is the other one
_NUMBERS = ("float", "integer", "unsigned", "boolean")


class InfluxHistory:
    """A server of InfluxDB, asked by a request for each address.

    The fields of a measurement are asked for once, not with each of its windows.
    """

    def __init__(self) -> None:
        self._kinds_of_fields: dict[str, dict[str, str]] = {}

    def close(self) -> None:
        """Forget the fields of measurements; no connection is kept open."""
        self._kinds_of_fields = {}

    def _fields(self, at: Address) -> dict[str, str]:
        """Names of the measurement's fields of numbers, without units → as the server has them."""
        if at.shown not in self._kinds_of_fields:
            self._kinds_of_fields[at.shown] = _kinds_of_fields(at)
        return _fields_of_numbers(at, self._kinds_of_fields[at.shown])

    def span(self, at: Address) -> tuple[datetime, datetime] | None:
        """The instants of the first and the last row."""
        fields = self._fields(at)
        ends = []
        # each field by itself: several of these functions in one question have no instant
        for tag in at.tags or fields:
            for function in ("FIRST", "LAST"):
                query = f"SELECT {function}({_name(fields[tag])}) {_from(at)}"
                ends += [series["values"][0][0] for series in _answers(at, query)]
        if not ends:
            return None
        return _instant(min(ends)), _instant(max(ends))

    def values_of(self, at: Address, column: str) -> list[str]:
        """The values of one of Influx's tags, in order; BadRecord where there is none of this
        name.
        """
        measurement = _name(at.table[-1])
        keys = [
            str(name)
            for series in _answers(at, f"SHOW TAG KEYS FROM {measurement}")
            for (name,) in series["values"]
        ]
        if column not in keys:
            raise BadRecord(
                f"{at.shown}: no tag {column!r} to part rows by;"
                f" {known_names(column, keys, 'there are')}"
            )
        query = f"SHOW TAG VALUES FROM {measurement} WITH KEY = {_name(column)}"
        return sorted(str(value) for series in _answers(at, query) for _, value in series["values"])

    def record(self, at: Address, options: ReadOptions) -> Record:
        """The record of an address; the unit of a field is that of its name, `speed [rpm]`.

        Raises
        ------
        BadRecord
            A server that refuses, no such database, measurement or field, rows that other tags tell
            apart, no rows; as `on_one_base` for times that do not lie on one base.
        HistoryAway
            A server that does not answer.
        """
        fields = self._fields(at)
        tags = at.tags or tuple(fields)
        sources, instants, values = _rows(at, [fields[tag] for tag in tags])
        if len(sources) > 1:
            listed = "; ".join(_written(labels) for labels in sources[:_LISTED])
            example = next(iter(sources[0].items()))
            raise BadRecord(
                f"{at.shown}: holds rows of several sources ({listed}); say which, as"
                f" &{urlencode([example])}"
            )
        if not len(instants):
            raise BadRecord(f"{at.shown}: no rows in that time")
        channels = [
            TimedChannel(tag, unit_of_head(fields[tag])[1], instants, row)
            for tag, row in zip(tags, values, strict=True)
        ]
        return on_one_base(channels, at.shown, options)


def _instant(microseconds: float) -> datetime:
    return _EPOCH + timedelta(microseconds=int(microseconds))


def _written(labels: Mapping[str, str]) -> str:
    return ", ".join(f"{name}={value}" for name, value in labels.items())


def _fields_of_numbers(at: Address, kinds: Mapping[str, str]) -> dict[str, str]:
    numbers = [name for name, kind in kinds.items() if kind in _NUMBERS]
    # a field is asked for by its name alone or, as in the database, with its unit
    by_name = {unit_of_head(name)[0]: name for name in numbers}
    wanted = by_name | {name: name for name in numbers if name in at.tags}
    for tag in at.tags:
        if tag not in wanted:
            raise BadRecord(
                f"{at.shown}: no field of numbers {tag!r}; {known_names(tag, by_name, 'there are')}"
            )
    if not wanted:
        raise BadRecord(f"{at.shown}: has no field of numbers; there are {', '.join(kinds)}")
    return wanted


def _kinds_of_fields(at: Address) -> dict[str, str]:
    measurement = at.table[-1]
    kinds: dict[str, str] = {}
    for series in _answers(at, f"SHOW FIELD KEYS FROM {_name(measurement)}"):
        kinds |= {str(name): str(kind) for name, kind in series["values"]}
    if kinds:
        return kinds
    known = [
        str(name) for series in _answers(at, "SHOW MEASUREMENTS") for (name,) in series["values"]
    ]
    raise BadRecord(
        f"{at.shown}: no measurement {measurement!r};"
        f" {known_names(measurement, known, 'there are')}"
    )


def _rows(at: Address, fields: list[str]) -> tuple[list[dict[str, str]], FloatArray, FloatArray]:
    """The tags that tell rows apart, instants [s since 1970], values (fields, n); NaN where there
    is no value.
    """
    # by all of Influx's tags: rows of two sources would else come as one, mixed
    query = f"SELECT {', '.join(map(_name, fields))} {_from(at)} GROUP BY *"
    sources: list[dict[str, str]] = []
    blocks = []
    for series in _answers(at, query):
        labels = {name: value for name, value in series.get("tags", {}).items() if value}
        if labels not in sources:
            sources.append(labels)
        # microseconds since 1970 stay below 2^53, so a double holds them exactly; null is NaN
        blocks.append(np.array(series["values"], dtype=np.float64))
    table = np.concatenate(blocks) if blocks else np.empty((0, 1 + len(fields)))
    return sources, 1e-6 * table[:, 0], np.ascontiguousarray(table[:, 1:].T)


def _from(at: Address) -> str:
    """Which rows, as InfluxQL says it."""
    ends = [(">=", at.start), ("<", at.end)]
    conditions = [
        f"time {sign} '{instant.isoformat().replace('+00:00', 'Z')}'"
        for sign, instant in ends
        if instant is not None
    ]
    conditions += [f"{_name(name)} = {_text(value)}" for name, value in at.where.items()]
    where = f" WHERE {' AND '.join(conditions)}" if conditions else ""
    return f"FROM {'.'.join(map(_name, at.table))}{where}"


def _name(name: str) -> str:
    escaped = name.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def _text(value: str) -> str:
    escaped = value.replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"


def _answers(at: Address, query: str) -> Iterator[dict[str, Any]]:
    """The series of a query's answer, as the server sends them."""
    asked = {
        "db": at.server["dbname"],
        "q": query,
        "epoch": "u",
        # Rows are read as they arrive: a long answer is never held whole as a text.
        "chunked": "true",
        "chunk_size": _CHUNK,
    }
    scheme = "https" if at.scheme == "influxs" else "http"
    host = f"{at.server['host']}:{at.server['port'] or _PORT}"
    url = f"{scheme}://{host}/query?{urlencode(asked)}"
    try:
        with urlopen(Request(url, headers=_credentials(at)), timeout=_PATIENCE) as answer:
            for line in answer:
                yield from _series(at, orjson.loads(line))
    except HTTPError as error:
        raise BadRecord(f"{at.shown}: {error.code} {_refusal(error)}") from None
    except (URLError, OSError) as error:
        raise HistoryAway(f"{at.shown}: {in_one_line(error)}") from None
    except orjson.JSONDecodeError:
        raise BadRecord(f"{at.shown}: is no server of InfluxDB: its answer is not JSON") from None


def _series(at: Address, answer: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    for result in answer.get("results", [answer]):
        if "error" in result:
            raise BadRecord(f"{at.shown}: {result['error']}")
        yield from result.get("series", [])


def _credentials(at: Address) -> dict[str, str]:
    # a user and a password before a token: the address says more than the environment
    password = at.server.get("password") or os.environ.get("INFLUX_PASSWORD")
    if at.server.get("user") and password:
        both = f"{at.server['user']}:{password}".encode()
        return {"Authorization": f"Basic {base64.b64encode(both).decode()}"}
    token = os.environ.get("INFLUX_TOKEN")
    return {"Authorization": f"Token {token}"} if token else {}


def _refusal(error: HTTPError) -> str:
    """What a server says in its body, else the reason of its status."""
    try:
        answer = json.loads(error.read(_CHUNK))
        # versions 1 and 3 call it `error`, version 2 `message`
        return str(answer.get("error") or answer.get("message") or error.reason)
    except (ValueError, AttributeError):
        return str(error.reason)
