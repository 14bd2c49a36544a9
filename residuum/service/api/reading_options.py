"""How a file that comes over HTTP is to be read: the options of the command line, as keys of the
query.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any, NamedTuple

from starlette.datastructures import QueryParams

from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.identification.record_formats.loggers.logger_time import FORMS
from residuum.service.body_errors import BadBody
from residuum.service.remedies_over_http import as_query, in_json, in_upload, of_array, refusing_in

_OF_THE_FILE = {
    "unit": "CHANNEL=UNIT, once a channel: the unit of a column that has none.",
    "time": "Name of the column of times.",
    "resample": "true: accept uneven time stamps; longer holes stay missing.",
    "missing": (
        "CELL, once a spelling: what means no value in a logger's file, such as OL or -999.9."
    ),
    "decimal": "Decimal sign of a logger's file that leaves it open: . or ,",
    "names": "NAME,…: names of all columns of a logger's file without heads, units in brackets.",
    "duplicates": (
        "What becomes of a logger's rows of one stamp: first, mean, or spread (evenly until the"
        " next stamp)."
    ),
    "reordered": (
        "What becomes of a logger's rows out of order: sort, or bridge (only the clock was set)."
    ),
    "time_form": f"Form of a logger's times: {', '.join(FORMS)}.",
}
READING_OPTIONS = _OF_THE_FILE | {
    "map": "NAME=COLUMN, once a signal: take the signal NAME from this column."
}
"""Key and meaning of what may be said of a body that is a file; several of `unit`, `map` and
`missing` are taken.
"""
# How the kinds of bodies are read that say their units themselves. Refusals name a way on that is
# one there: a key that such a body does not take is none.
_SAID_ITSELF = {"application/json": in_json, "application/octet-stream": of_array}
_TRUE, _FALSE = ("true", "1", "yes", "on"), ("false", "0", "no", "off")


class Reading(NamedTuple):
    """Options of `ReadOptions` as plain values, and the names that columns get."""

    options: dict[str, Any]
    renames: dict[str, str]

    def renamed(self, record: Record) -> Record:
        """The record with its columns called as was said."""
        return record.rename(self.renames) if self.renames else record


def reading_of(query: QueryParams) -> Reading:
    """What a query says of reading; BadInput names the key that is malformed."""
    options: dict[str, Any] = {
        key: query[key]
        for key in ("decimal", "time_form", "duplicates", "reordered")
        if key in query
    }
    if "missing" in query:
        options["missing"] = query.getlist("missing")
    # Commas part names; a blank is part of one, as in `Motor voltage [V]`.
    if "names" in query:
        options["names"] = query["names"].split(",")
    if "time" in query:
        options["time_column"] = query["time"]
    if "resample" in query:
        options["resample"] = _truth(query["resample"])
    return reading(options, query.getlist("map"), query.getlist("unit"))


def reading(plain: Mapping[str, Any], maps: Sequence[str], units: Sequence[str]) -> Reading:
    """Plain options with `map` and `unit` texts; a unit is said of a column, or of the name that it
    gets.
    """
    columns = _pairs("map", maps)
    options = dict(plain)
    # `time` is no signal: its column is named among the others and taken out.
    if "time" in columns:
        if options.get("time_column") is not None:
            # Two ways to say one thing: that one of them goes over the other would be found out by
            # nobody.
            raise BadBody("query: time=COLUMN and map=time=COLUMN are one option; give one of them")
        options["time_column"] = columns.pop("time")
    unit_of_column = {columns.get(name, name): unit for name, unit in _pairs("unit", units).items()}
    if unit_of_column:
        options["units"] = unit_of_column
    return Reading(options, {column: name for name, column in columns.items()})


def remedies_in_query(kind: str = "") -> AbstractContextManager[None]:
    """Let refusals name the keys of the query, or of a body of this kind."""
    return refusing_in(_SAID_ITSELF.get(kind, as_query))


def remedies_in_upload() -> AbstractContextManager[None]:
    """Let refusals of a stored record name the keys with which it is stored."""
    return refusing_in(in_upload)


def only_of_files(query: QueryParams, kind: str) -> None:
    """Refuse options of a file for a body that says these things itself."""
    given = [key for key in _OF_THE_FILE if key in query]
    if given:
        raise BadInput(
            f"query, {given[0]}: is an option for files (text/csv, application/zip); {kind} says it"
            " itself"
        )


def _pairs(key: str, texts: Sequence[str]) -> dict[str, str]:
    pairs = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not (name and equals and value):
            raise BadInput(
                f"query, {key} {text[:60]!r}: must be"
                f" {'NAME=COLUMN' if key == 'map' else 'CHANNEL=UNIT'}"
            )
        pairs[name] = value
    return pairs


def _truth(text: str) -> bool:
    if text.lower() not in (*_TRUE, *_FALSE):
        raise BadInput(f"query, resample: {text[:40]!r} is neither true nor false")
    return text.lower() in _TRUE
