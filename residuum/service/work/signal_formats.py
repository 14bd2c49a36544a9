"""A window's signals from a stranger's bytes: JSON, CSV or NPZ; every declared size is checked
before anything is allocated.
"""

from __future__ import annotations

import codecs
import io
import re
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

import numpy as np
import orjson

from residuum.identification.errors import BadRecord, in_one_line
from residuum.identification.npy_header import LONGEST_HEADER
from residuum.identification.record import Record
from residuum.identification.record_formats import parse_csv, read_record
from residuum.identification.record_formats.loggers.no_value import without_overloads
from residuum.service.body_errors import BadBody, TooLarge
from residuum.service.work.npy import read_header

MOST_CHANNELS = 256
# What reading an archive raises that is none, or is damaged.
_DAMAGED = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    NotImplementedError,
    EOFError,
    OSError,
    RuntimeError,
    ValueError,
)
_NO_NUMBER = re.compile(r"-?(NaN|nan|Infinity|inf)\b")
_UNQUOTED = "; numbers stand without quotes, a missing sample is null"
_NUMBERS = (int, float, type(None))
# Characters of all notes: they are stored with a record, and shown with each answer.
_LONGEST_NOTES = 64 * 2**10
_JSON_KEYS = {"sample_time", "t0", "channels", "units", "notes"}


def from_json(body: bytes, _unpacked: int) -> Record:
    """Of an object with `sample_time`, `channels`, `units` and, if it likes, `t0` and `notes`; null
    is a missing sample.
    """
    try:
        content = orjson.loads(body.removeprefix(codecs.BOM_UTF8))
    except orjson.JSONDecodeError as error:
        # orjson has one error for both: what was short was ours, not the sender's
        if "memory" in error.msg:
            raise MemoryError from None
        says = (
            "JSON is UTF-8, send it so"
            if _other_text(body)
            else f"{error}{_no_number(body, error.pos)}"
        )
        raise BadBody(f"body: is not JSON: {says}") from None
    if not isinstance(content, dict) or not isinstance(content.get("channels"), dict):
        raise BadBody("body: must be an object with 'sample_time', 'channels' and 'units'")
    unknown = set(content) - _JSON_KEYS
    if unknown:
        key = sorted(unknown)[0][:60]
        rate = "; say sample_time, 1 / sampling_rate" if key == "sampling_rate" else ""
        raise BadBody(f"body: key {key!r} is not one of {', '.join(sorted(_JSON_KEYS))}{rate}")
    channels = {name: _samples(name, values) for name, values in content["channels"].items()}
    return Record(
        few(channels),
        _texts(content.get("units"), "units"),
        _number(content.get("sample_time"), "sample_time"),
        _number(content.get("t0", 0.0), "t0"),
        notes=_notes(content.get("notes", [])),
        source="http",
    )


def _other_text(body: bytes) -> bool:
    """Whether a body is text in another encoding: UTF-16, UTF-32, or one of single bytes."""
    try:
        return "\0" in body.decode()
    except UnicodeDecodeError:
        return True


def _no_number(body: bytes, at: int) -> str:
    """What to write instead of the words that some programs write for numbers JSON does not
    have.
    """
    match = _NO_NUMBER.match(body.decode("utf-8", "replace"), at)
    return "; JSON has neither NaN nor Infinity, a missing sample is null" if match else ""


def from_csv(body: bytes, _unpacked: int) -> Record:
    """Of our own form of CSV."""
    return without_overloads(parse_csv(body, source="body"))


def from_npz(body: bytes, unpacked: int) -> Record:
    """Of an NPZ whose arrays hold at most `unpacked` bytes in all."""
    check_npz(io.BytesIO(body), unpacked)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "body.npz"
        file.write_bytes(body)
        try:
            # the file is of this moment, and its name says nothing
            return replace(read_record(file), source="http")
        except BadRecord as error:
            error.what = error.what.replace(str(file), "body")
            raise


FORMATS: dict[str, Callable[[bytes, int], Record]] = {
    "application/json": from_json,
    "text/csv": from_csv,
    "application/zip": from_npz,
}
"""By content type; called with the body and the bytes to which it may unpack."""


def unpacked_size(body: bytes) -> int:
    """Bytes that the arrays of an NPZ say they hold in all (none of them can hold more); 0 for what
    is no NPZ.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(body)) as archive:
            return sum(member.file_size for member in archive.infolist())
    except _DAMAGED:
        return 0


def check_npz(file: IO[bytes], unpacked: int, subject: str = "body") -> None:
    """Refuse an NPZ that holds more than `unpacked` bytes in all, or whose arrays differ from what
    their headers declare.
    """
    try:
        with zipfile.ZipFile(file) as archive:
            members = archive.infolist()
            if (
                len(members) > MOST_CHANNELS
                or sum(member.file_size for member in members) > unpacked
            ):
                raise TooLarge(
                    f"{subject}: an NPZ of more than {MOST_CHANNELS} arrays or {unpacked} bytes"
                    " unpacked; no more are read"
                )
            for member in members:
                _check_member(archive, member, subject)
    except (BadBody, TooLarge):
        raise
    except _DAMAGED as error:
        raise BadBody(f"{subject}: is not an NPZ file: {in_one_line(error)}") from None


def _check_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo, file: str) -> None:
    where = f"{file}: NPZ member {member.filename[:60]!r}"
    with archive.open(member) as stream:
        header = read_header(stream.read(2 * LONGEST_HEADER), where)
    # objects would be unpickled: floats, whole numbers, booleans and texts are plain
    if header.dtype.kind not in "fiubU":
        raise BadBody(f"{where}: is not a plain array")
    if header.start + header.size > member.file_size:
        raise BadBody(
            f"{where}: declares {header.size} bytes and holds {member.file_size - header.start}"
        )


def few(channels: Mapping[str, Any]) -> Mapping[str, Any]:
    """The channels, when they are not too many."""
    if len(channels) > MOST_CHANNELS:
        raise TooLarge(f"body: {len(channels)} channels; at most {MOST_CHANNELS} are read")
    return channels


def _samples(name: str, values: Any) -> np.ndarray[Any, Any]:
    if not isinstance(values, list):
        raise BadBody(f"body, channel {name[:60]!r}: must be an array of numbers")
    for index, value in enumerate(values):
        # not isinstance: true and false are whole numbers in Python
        if type(value) not in _NUMBERS:
            how = _UNQUOTED if isinstance(value, str) else ""
            raise BadBody(
                f"body, channel {name[:60]!r}, sample {index}: {str(value)[:40]!r} is not a"
                f" number{how}"
            )
    return np.array(values, dtype=np.float64)


def _texts(content: Any, field: str) -> dict[str, str]:
    if not isinstance(content, dict) or not all(
        isinstance(value, str) for value in content.values()
    ):
        raise BadBody(
            f'body, {field}: must be an object of channel name to text, as {{"speed": "rpm"}}'
        )
    return content


def _number(content: Any, field: str) -> float:
    if type(content) not in (int, float):
        raise BadBody(f"body, {field}: must be a number")
    return float(content)


def _notes(content: Any) -> tuple[str, ...]:
    if not isinstance(content, list) or not all(isinstance(note, str) for note in content):
        raise BadBody("body, notes: must be an array of texts")
    if sum(map(len, content)) > _LONGEST_NOTES:
        raise BadBody(
            f"body, notes: more than {_LONGEST_NOTES} characters in all; no more are kept"
        )
    return tuple(content)
