"""The body of a request as a Record: JSON, .npy, CSV or NPZ, by content type; never read in the way
of other requests.

What is short is read on the event loop, what is longer in a thread. JSON and CSV that are long, and
NPZ that may be, are read in a process of their own with limits: their parsers hold the interpreter
for as long as they take, and a thread would not help.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

from fastapi import Request
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import QueryParams

from residuum.diagnosis.diagnosers.base import Channel
from residuum.identification.record import Record
from residuum.identification.record_formats import CAN_LOGS
from residuum.identification.record_formats.csv import is_ours
from residuum.identification.units import registry_is_read
from residuum.service.api.reading_options import READING_OPTIONS, Reading, only_of_files, reading_of
from residuum.service.body_errors import BadBody, UnsupportedBody
from residuum.service.machines.adding import known_dbc
from residuum.service.work.npy import read_npy
from residuum.service.work.signal_formats import FORMATS, few, unpacked_size
from residuum.service.work.upload_reader import read_body, read_upload

if TYPE_CHECKING:
    from residuum.service.services import Services

READ_ON_THE_LOOP = 64 * 2**10
"""Bytes up to which a body is read on the event loop: a few milliseconds."""
# Bytes from which JSON and CSV are read in a process of their own: their parsers hold the
# interpreter for some 20 ms then.
_APART = 512 * 2**10
# Bytes to which an NPZ may unpack in a thread of the service; beyond, a bomb meets a process with
# limits.
_APART_UNPACKED = 8 * 2**20
_PACKED = "application/zip"
_ARRAY = "application/octet-stream"
_KINDS = ("application/json", _ARRAY, "text/csv", _PACKED)
# Keys that say of a body that it is a CAN log, whatever its content type: logs have none of their
# own.
_OF_LOGS = {"dbc", "filename"}
_OF_ARRAYS = ("sampling_rate", "t0", "channel")
_ENDINGS = {"text/csv": ".csv", _PACKED: ".npz"}
_HEAD = re.compile(r"^(?P<name>[^\[\]]{1,200}?)\s*\[(?P<unit>[^\[\]]{0,80})\]$")


def query_parameter(name: str, kind: str, says: str, *, repeated: bool = False) -> dict[str, Any]:
    """A key of a query, as the OpenAPI document has it."""
    schema = {"type": "array", "items": {"type": kind}} if repeated else {"type": kind}
    return {"in": "query", "name": name, "required": False, "description": says, "schema": schema}


SIGNAL_QUERY = [
    query_parameter(
        "sample_time",
        "number",
        ".npy (or `sampling_rate` [Hz]), a file that does not say it: seconds between samples.",
    ),
    query_parameter(
        "sampling_rate", "number", ".npy: samples a second [Hz], instead of `sample_time`."
    ),
    query_parameter("t0", "number", ".npy: time of the first sample [s]."),
    query_parameter(
        "channel", "string", ".npy: `name [unit]`, once a row of the array.", repeated=True
    ),
    *(
        query_parameter(
            name,
            "string",
            f"CSV, NPZ: {says}" if name != "map" else says,
            repeated=name in ("map", "unit", "missing"),
        )
        for name, says in READING_OPTIONS.items()
    ),
    query_parameter(
        "dbc",
        "string",
        f"DBC file of a watched machine, by its name, for a CAN log ({', '.join(CAN_LOGS)}).",
    ),
    query_parameter("filename", "string", "Name of that log; its ending says the format."),
]
"""What may be said of a body of signals in the query."""

SIGNAL_BODY: dict[str, Any] = {
    "parameters": SIGNAL_QUERY,
    "requestBody": {
        "required": True,
        "description": (
            "One window. A sample that is missing is null in JSON, NaN in arrays, an empty cell in"
            " CSV."
        ),
        "content": {
            "application/json": {
                "schema": {
                    "type": "object",
                    "required": ["sample_time", "channels", "units"],
                    "additionalProperties": False,
                    "properties": {
                        "sample_time": {
                            "type": "number",
                            "exclusiveMinimum": 0,
                            "description": "Seconds between samples.",
                        },
                        "t0": {
                            "type": "number",
                            "description": "Time of the first sample [s], the recorder's clock.",
                        },
                        "channels": {
                            "type": "object",
                            "minProperties": 1,
                            "additionalProperties": {
                                "type": "array",
                                "items": {"type": ["number", "null"]},
                                "minItems": 1,
                            },
                            "description": "Samples by channel name, all of one length.",
                        },
                        "units": {"type": "object", "additionalProperties": {"type": "string"}},
                        "notes": {"type": "array", "items": {"type": "string"}},
                    },
                }
            },
            "application/octet-stream": {
                "schema": {"type": "string", "format": "binary"},
                "example": (
                    "an .npy array of shape (n,) or (channels, n); say sample_time and channel in"
                    " the query"
                ),
            },
            "text/csv": {"schema": {"type": "string"}},
            "application/zip": {"schema": {"type": "string", "format": "binary"}},
        },
    },
}
"""What routes that take signals say of their body in the OpenAPI document."""


def kind_of(request: Request) -> str:
    """The content type of a body, without its parameters."""
    return request.headers.get("content-type", "").split(";")[0].strip().lower()


async def record_of(request: Request, expected: Sequence[Channel] = ()) -> Record:
    """The record in a request's body.

    An .npy array carries no names: the query says `sample_time` and, once a row, `channel=name
    [unit]`; without `channel` the rows are the required channels of the diagnoser, in its order and
    units.

    Raises BadBody, BadRecord, BadUnit, TooLarge or UnsupportedBody, each with one line.
    """
    kind = kind_of(request)
    if _tells_log(request.scope["query_string"]):
        return await _can_log(request)
    # 415 (RFC 9110, 15.5.16) for forms, compressed bodies and what is not said; nothing is guessed
    # from the bytes.
    if kind not in _KINDS:
        raise UnsupportedBody(f"Content-Type {kind[:60]!r}: is not one of {', '.join(_KINDS)}")
    reading = _reading(request.scope["query_string"], kind)
    return reading.renamed(await _read(request, kind, reading, expected))


@lru_cache(maxsize=256)
def _tells_log(query_string: bytes) -> bool:
    return bool(_OF_LOGS & QueryParams(query_string).keys())


async def _can_log(request: Request) -> Record:
    """A CAN log, whose format its name says, by a DBC file that the service knows."""
    services: Services = request.app.state.services
    name, bus = (request.query_params.get(key, "") for key in ("filename", "dbc"))
    ending = next((known for known in CAN_LOGS if name.lower().endswith(known)), None)
    if ending is None or not bus:
        logs = ", ".join(CAN_LOGS)
        raise BadBody(
            f"query: filename (a CAN log, {logs}) and dbc (the DBC file of its bus) go together for"
            " a body that is a log"
        )
    reading, settings = reading_of(request.query_params), services.settings
    body, dbc = (
        await body_of(request),
        await run_in_threadpool(known_dbc, settings, services.store, bus),
    )
    within: dict[str, Any] = {"memory": settings.upload_memory, "seconds": settings.upload_seconds}
    return reading.renamed(
        await services.reading(
            read_upload, body, ending, name[:200], **within, options=reading.options, dbc=dbc
        )
    )


async def _read(
    request: Request, kind: str, reading: Reading, expected: Sequence[Channel]
) -> Record:
    services: Services = request.app.state.services
    body, settings = await body_of(request), services.settings
    # A stranger's file, to be understood: as an upload is, in a process of its own.
    if reading.options or (kind == "text/csv" and not is_ours(body)):
        within: dict[str, Any] = {
            "memory": settings.upload_memory,
            "seconds": settings.upload_seconds,
        }
        return await services.reading(
            read_upload, body, _ENDINGS[kind], "body", **within, options=reading.options
        )
    if kind == _ARRAY:
        return await _off_the_loop(body, _from_npy, body, request.scope["query_string"], expected)
    if (
        kind == _PACKED
        and len(body) <= _APART
        and await run_in_threadpool(unpacked_size, body) <= _APART_UNPACKED
    ):
        return await run_in_threadpool(FORMATS[kind], body, settings.body_limit)
    if kind != _PACKED and len(body) <= _APART:
        return await _off_the_loop(body, FORMATS[kind], body, settings.body_limit)
    limits = {
        "memory": settings.upload_memory,
        "seconds": settings.upload_seconds,
        "unpacked": settings.body_limit,
    }
    return await services.reading(read_body, body, kind, **limits)


@lru_cache(maxsize=256)
def _reading(query_string: bytes, kind: str) -> Reading:
    """What a query says of reading a body of this kind."""
    query = QueryParams(query_string)
    # JSON and arrays say units and times themselves: an option for files would be passed over
    # there.
    if kind not in _ENDINGS:
        only_of_files(query, kind)
    given = [key for key in _OF_ARRAYS if key in query]
    if kind != _ARRAY and given:
        raise BadBody(f"query, {given[0]}: is an option for .npy arrays; {kind} says it itself")
    reading = reading_of(query)
    if kind in _ENDINGS and "sample_time" in query:
        return reading._replace(
            options=reading.options | {"sample_time": _query_number(query, "sample_time", None)}
        )
    if kind == "application/json" and "sample_time" in query:
        raise BadBody('query, sample_time: a body in JSON says it itself, "sample_time": seconds')
    return reading


async def body_of(request: Request) -> bytes:
    """The whole body; the pieces of a long one are put together in a thread."""
    if not hasattr(request, "_body"):
        pieces = [piece async for piece in request.stream()]
        long = sum(map(len, pieces)) > _APART
        request._body = await run_in_threadpool(b"".join, pieces) if long else b"".join(pieces)
    return request._body


async def _off_the_loop(body: bytes, read: Callable[..., Record], *arguments: Any) -> Record:
    # The registry of units is read with the first unit, which takes long: not on the loop.
    short = len(body) <= READ_ON_THE_LOOP and registry_is_read()
    return read(*arguments) if short else await run_in_threadpool(read, *arguments)


def _from_npy(body: bytes, query: bytes, expected: Sequence[Channel]) -> Record:
    array = read_npy(body)
    rows = array.reshape(1, -1) if array.ndim == 1 else array
    header = _description(query)
    # An array without names has the channels that the diagnoser needs, in its order.
    names = header.names or tuple(
        (channel.name, channel.unit) for channel in expected if channel.required
    )
    if len(names) != rows.shape[0]:
        shown = ", ".join(f"{name} [{unit}]" for name, unit in names) or "none"
        raise BadBody(
            f"body: the array has {rows.shape[0]} rows, and these channels are named: {shown};"
            " shape is (channels, n)"
        )
    # The later row would replace the earlier one without a word.
    if len({name for name, _ in names}) != len(names):
        raise BadBody("query: a channel is named twice")
    channels = {name: row for (name, _), row in zip(names, rows, strict=True)}
    return Record(few(channels), dict(names), header.sample_time, header.t0, source="http")


class _Description(NamedTuple):
    """What a query says of an .npy body: names and units of its rows (none: the diagnoser's), and
    when they were taken [s].
    """

    names: tuple[tuple[str, str], ...]
    sample_time: float
    t0: float


@lru_cache(maxsize=256)
def _description(query_string: bytes) -> _Description:
    """The description in a query; remembered, since a client asks with the same one again and
    again.
    """
    query = QueryParams(query_string)
    names = tuple(_head(text) for text in query.getlist("channel"))
    return _Description(names, _sample_time(query), _query_number(query, "t0", 0.0))


def _head(text: str) -> tuple[str, str]:
    match = _HEAD.match(text.strip())
    if match is None:
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
