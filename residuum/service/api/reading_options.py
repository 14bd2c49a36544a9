"""How a file that comes over HTTP is to be read: the options of the command line, as keys of the query."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple
from urllib.parse import quote

from starlette.datastructures import QueryParams

from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.identification.record_formats.loggers.logger_time import FORMS
from residuum.service.bad_bodies import BadBody

_OF_THE_FILE = {
    "unit": "CHANNEL=UNIT, once a channel: the unit of a column that has none.",
    "time": "Name of the column of times.",
    "resample": "true: accept uneven time stamps; longer holes stay missing.",
    "missing": "CELL, once a spelling: what means no value in a logger's file, such as OL or -999.9.",
    "decimal": "Decimal sign of a logger's file that leaves it open: . or ,",
    "time_form": f"Form of a logger's times: {', '.join(FORMS)}.",
}
READING_OPTIONS = _OF_THE_FILE | {"map": "NAME=COLUMN, once a signal: take the signal NAME from this column."}
"""Key and meaning of what may be said of a body that is a file; several of `unit`, `map` and `missing` are taken."""
_KEYS = {
    "sample-time": ("sample_time", "SECONDS"),
    "resample": ("resample", "true"),
    "decimal": ("decimal", "SIGN"),
    "time": ("time_form", "FORM"),
    "unit": ("unit", "CHANNEL=UNIT"),
    "map": ("map", "NAME=COLUMN"),
}
"""Option of the command line → key of the query, and what stands for its value."""
_OPTION = re.compile(rf"--({'|'.join(_KEYS)})\b(?![-\w])( [\w]+=[^\s,;)]+|(?<=--time) (?:'[^']+'|seconds\b))?")
_MISSING = re.compile(r"`residuum inspect FILE --missing ('[^']*'|[^\s`]+) --out FILE[^`]*` says so")
"""What a mapping settles for the commands, and a key of the query here."""
_OF_TIME = {"--map time=COLUMN": "?time=COLUMN", "`residuum inspect FILE --time seconds`": "?time_form=seconds"}
"""What has a key of its own here."""
_COMMAND = re.compile(r"(`[^`]*`)")
_BESIDE = re.compile(r" \(`residuum inspect FILE` with it [^)]*\)$")
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
    said: dict[str, Any] = {key: query[key] for key in ("decimal", "time_form") if key in query}
    if "missing" in query:
        said["missing"] = query.getlist("missing")
    if "time" in query:
        said["time_column"] = query["time"]
    if "resample" in query:
        said["resample"] = _truth(query["resample"])
    return reading(said, query.getlist("map"), query.getlist("unit"))


def reading(said: Mapping[str, Any], maps: Sequence[str], units: Sequence[str]) -> Reading:
    """Plain options with `map` and `unit` texts; a unit is said of a column, or of the name that it gets."""
    columns = _pairs("map", maps)
    options = dict(said)
    if "time" in columns:
        if options.get("time_column") is not None:
            raise BadBody("query: time=COLUMN and map=time=COLUMN are one option; give one of them")
        options["time_column"] = columns.pop("time")
    if told := {columns.get(name, name): unit for name, unit in _pairs("unit", units).items()}:
        options["units"] = told
    return Reading(options, {column: name for name, column in columns.items()})


@contextmanager
def remedies_in_query() -> Iterator[None]:
    """Let refusals name the keys of the query where readers name the options of the command line."""
    try:
        yield
    except BadInput as error:
        error.args = (_in_query(str(error)),)
        raise


def _in_query(says: str) -> str:
    """A refusal whose options are keys of the query; what is said of a command stays, but not that a file beside settles it.

    >>> _in_query("say --time 'day first' or --time 'month first'")
    "say ?time_form='day first' or ?time_form='month first'"
    >>> _in_query("if it means no value, `residuum inspect FILE --missing 'OL' --out FILE.mapping.yaml` says so")
    'if it means no value, say ?missing=OL'
    """
    for option, key in _OF_TIME.items():
        says = says.replace(option, key)
    says = _MISSING.sub(lambda found: f"say ?missing={quote(found[1].strip(chr(39)))}", _BESIDE.sub("", says))
    return "".join(part if part.startswith("`") else _OPTION.sub(_key, part) for part in _COMMAND.split(says))


def _key(match: re.Match[str]) -> str:
    key, example = _KEYS[match[1]]
    return f"?{key}={match[2].strip() if match[2] else example}"


def only_of_files(query: QueryParams, kind: str) -> None:
    """Refuse options of a file for a body that says these things itself."""
    if given := next((key for key in _OF_THE_FILE if key in query), None):
        raise BadInput(f"query, {given}: is an option for files (text/csv, application/zip); {kind} says it itself")


def _pairs(key: str, texts: Sequence[str]) -> dict[str, str]:
    found = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not (name and equals and value):
            raise BadInput(f"query, {key} {text[:60]!r}: must be {'NAME=COLUMN' if key == 'map' else 'CHANNEL=UNIT'}")
        found[name] = value
    return found


def _truth(text: str) -> bool:
    if text.lower() not in (*_TRUE, *_FALSE):
        raise BadInput(f"query, resample: {text[:40]!r} is neither true nor false")
    return text.lower() in _TRUE
