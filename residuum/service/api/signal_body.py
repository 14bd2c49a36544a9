"""The body of a request as a Record: JSON, .npy, CSV or NPZ, by content type."""

from __future__ import annotations

import io
import re
import tempfile
import zipfile
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import orjson
from fastapi import Request
from starlette.datastructures import QueryParams

from residuum.diagnosis.diagnosers.base import Channel
from residuum.identification.errors import BadRecord
from residuum.identification.record import Record
from residuum.identification.record_formats import parse_csv, read_record
from residuum.service.api.npy import read_npy
from residuum.service.problems import BadBody, TooLarge, UnsupportedBody

LARGEST_UNPACKED = 512 * 2**20
"""What an NPZ may hold in all [bytes]."""
_MOST_CHANNELS = 256
_NUMBERS = (int, float, type(None))
_HEAD = re.compile(r"^(?P<name>[^\[\]]{1,200}?)\s*\[(?P<unit>[^\[\]]{0,80})\]$")
_DECLARED = re.compile(
    rb"'descr':\s*'[<>|=]?(?P<kind>[fiubU])(?P<width>[0-9]{1,9})'.{0,60}'shape':\s*\((?P<shape>[0-9, ]{0,60})\)"
)
_JSON_KEYS = {"sample_time", "t0", "channels", "units", "notes"}

SIGNAL_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "description": "One window. A sample that is missing is null in JSON, NaN in arrays, an empty cell in CSV.",
        "content": {
            "application/json": {
                "schema": {
                    "type": "object",
                    "required": ["sample_time", "channels", "units"],
                    "additionalProperties": False,
                    "properties": {
                        "sample_time": {"type": "number", "exclusiveMinimum": 0, "description": "Seconds between samples."},
                        "t0": {"type": "number", "description": "Time of the first sample [s], the recorder's clock."},
                        "channels": {
                            "type": "object",
                            "minProperties": 1,
                            "additionalProperties": {"type": "array", "items": {"type": ["number", "null"]}, "minItems": 1},
                            "description": "Samples by channel name, all of one length.",
                        },
                        "units": {"type": "object", "additionalProperties": {"type": "string"}},
                        "notes": {"type": "array", "items": {"type": "string"}},
                    },
                }
            },
            "application/octet-stream": {
                "schema": {"type": "string", "format": "binary"},
                "example": "an .npy array of shape (n,) or (channels, n); say sample_time and channel in the query",
            },
            "text/csv": {"schema": {"type": "string"}},
            "application/zip": {"schema": {"type": "string", "format": "binary"}},
        },
    }
}
"""What routes that take signals say of their body in the OpenAPI document."""


async def record_of(request: Request, expected: Sequence[Channel] = ()) -> Record:
    """The record in a request's body.

    An .npy array carries no names: the query says `sample_time` and, once a row, `channel=name [unit]`; without
    `channel` the rows are the required channels of the diagnoser, in its order and units.

    Raises BadBody, BadRecord, BadUnit, TooLarge or UnsupportedBody, each with one line.
    """
    kind = request.headers.get("content-type", "").split(";")[0].strip().lower()
    if kind not in READERS:
        raise UnsupportedBody(f"Content-Type {kind[:60]!r}: is not one of {', '.join(READERS)}")
    return READERS[kind](await request.body(), request.scope["query_string"], expected)


def _from_json(body: bytes, _query: bytes, _expected: Sequence[Channel]) -> Record:
    try:
        content = orjson.loads(body)
    except orjson.JSONDecodeError as error:
        raise BadBody(f"body: is not JSON: {error}") from None
    if not isinstance(content, dict) or not isinstance(content.get("channels"), dict):
        raise BadBody("body: must be an object with 'sample_time', 'channels' and 'units'")
    if unknown := set(content) - _JSON_KEYS:
        raise BadBody(f"body: key {sorted(unknown)[0][:60]!r} is not one of {', '.join(sorted(_JSON_KEYS))}")
    channels = {name: _samples(name, values) for name, values in content["channels"].items()}
    return Record(
        _few(channels),
        _texts(content.get("units"), "units"),
        _number(content.get("sample_time"), "sample_time"),
        _number(content.get("t0", 0.0), "t0"),
        notes=_notes(content.get("notes", [])),
        source="http",
    )


def _from_npy(body: bytes, query: bytes, expected: Sequence[Channel]) -> Record:
    array = read_npy(body)
    rows = array.reshape(1, -1) if array.ndim == 1 else array
    said = _description(query)
    names = said.names or tuple((channel.name, channel.unit) for channel in expected if channel.required)
    if len(names) != rows.shape[0]:
        shown = ", ".join(f"{name} [{unit}]" for name, unit in names) or "none"
        raise BadBody(f"body: the array has {rows.shape[0]} rows, and these channels are named: {shown}; shape is (channels, n)")
    if len({name for name, _ in names}) != len(names):
        raise BadBody("query: a channel is named twice")
    channels = {name: row for (name, _), row in zip(names, rows, strict=True)}
    return Record(_few(channels), dict(names), said.sample_time, said.t0, source="http")


class _Description(NamedTuple):
    """What a query says of an .npy body: names and units of its rows (none: the diagnoser's), and when they were taken [s]."""

    names: tuple[tuple[str, str], ...]
    sample_time: float
    t0: float


@lru_cache(maxsize=256)
def _description(query_string: bytes) -> _Description:
    """The description in a query; remembered, since a client asks with the same one again and again."""
    query = QueryParams(query_string)
    names = tuple(_head(text) for text in query.getlist("channel"))
    return _Description(names, _sample_time(query), _query_number(query, "t0", 0.0))


def _from_csv(body: bytes, _query: bytes, _expected: Sequence[Channel]) -> Record:
    return parse_csv(body, source="body")


def _from_npz(body: bytes, _query: bytes, _expected: Sequence[Channel]) -> Record:
    check_npz(io.BytesIO(body))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "body.npz"
        file.write_bytes(body)
        try:
            return read_record(file)
        except BadRecord as error:
            raise BadRecord(str(error).replace(str(file), "body")) from None


READERS: dict[str, Callable[[bytes, bytes, Sequence[Channel]], Record]] = {
    "application/json": _from_json,
    "application/octet-stream": _from_npy,
    "text/csv": _from_csv,
    "application/zip": _from_npz,
}


def check_npz(file: io.BufferedIOBase) -> None:
    """Refuse an NPZ whose arrays are larger in all than may be unpacked, or differ from what their headers declare."""
    try:
        with zipfile.ZipFile(file) as archive:
            members = archive.infolist()
            if len(members) > _MOST_CHANNELS or sum(member.file_size for member in members) > LARGEST_UNPACKED:
                raise TooLarge(f"body: an NPZ of more than {_MOST_CHANNELS} arrays or {LARGEST_UNPACKED} bytes unpacked")
            for member in members:
                _check_member(archive, member)
    except (zipfile.BadZipFile, NotImplementedError, EOFError, OSError, RuntimeError, ValueError, zipfile.LargeZipFile) as error:
        if isinstance(error, BadBody | TooLarge):
            raise
        raise BadBody(f"body: is not an NPZ file: {error}") from None


def _check_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> None:
    with archive.open(member) as stream:
        head = stream.read(2048)
    declared = _DECLARED.search(head)
    if not head.startswith(b"\x93NUMPY") or declared is None:
        raise BadBody(f"body: NPZ member {member.filename[:60]!r}: is not a plain array")
    width = int(declared["width"]) * (4 if declared["kind"] == b"U" else 1)
    needed = width * prod(int(size) for size in declared["shape"].replace(b" ", b"").split(b",") if size)
    if needed > member.file_size:
        raise BadBody(f"body: NPZ member {member.filename[:60]!r}: declares {needed} bytes and holds {member.file_size}")


def _samples(name: str, values: Any) -> np.ndarray[Any, Any]:
    if not isinstance(values, list):
        raise BadBody(f"body, channel {name[:60]!r}: must be an array of numbers")
    for index, value in enumerate(values):
        if type(value) not in _NUMBERS:
            raise BadBody(f"body, channel {name[:60]!r}, sample {index}: {str(value)[:40]!r} is not a number")
    return np.array(values, dtype=np.float64)


def _few(channels: Mapping[str, Any]) -> Mapping[str, Any]:
    if len(channels) > _MOST_CHANNELS:
        raise TooLarge(f"body: {len(channels)} channels; at most {_MOST_CHANNELS} are read")
    return channels


def _texts(content: Any, what: str) -> dict[str, str]:
    if not isinstance(content, dict) or not all(isinstance(value, str) for value in content.values()):
        raise BadBody(f"body, {what}: must be an object of channel name to text")
    return content


def _number(content: Any, what: str) -> float:
    if type(content) not in (int, float):
        raise BadBody(f"body, {what}: must be a number")
    return float(content)


def _notes(content: Any) -> tuple[str, ...]:
    if not isinstance(content, list) or not all(isinstance(note, str) for note in content):
        raise BadBody("body, notes: must be an array of texts")
    return tuple(content)


def _head(text: str) -> tuple[str, str]:
    if (match := _HEAD.match(text.strip())) is None:
        raise BadBody(f"query, channel {text[:60]!r}: must be 'name [unit]'")
    return match["name"], match["unit"]


def _sample_time(query: QueryParams) -> float:
    if "sampling_rate" in query and "sample_time" not in query:
        rate = _query_number(query, "sampling_rate", None)
        if not rate > 0:
            raise BadBody(f"query, sampling_rate: {rate!r}; must be positive [Hz]")
        return 1.0 / rate
    return _query_number(query, "sample_time", None)


def _query_number(query: QueryParams, name: str, default: float | None) -> float:
    text = query.get(name)
    if text is None:
        if default is None:
            raise BadBody(f"query: {name} is missing; an .npy body needs it")
        return default
    try:
        return float(text)
    except ValueError:
        raise BadBody(f"query, {name}: {text[:40]!r} is not a number") from None
