"""Uploaded files, and bodies that are long, are read in a limited process of their own.

As a program (`python -m residuum.service.work.upload_reader MEMORY SECONDS FILE HOW`) it reads FILE
and leaves the record beside it as plain arrays with a description in JSON.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import orjson

from residuum.identification import errors
from residuum.identification.errors import BadInput, BadRecord
from residuum.identification.record import Record
from residuum.identification.record_formats.npz import keep_plain, load_plain
from residuum.service.body_errors import BadBody, TooLarge
from residuum.service.work.limited_process import run_limited, within_limits

_OF_READING = (*vars(errors).values(), BadBody, TooLarge)
# What reading may raise, by the name under which the process tells it: a refusal is the same as
# without a process.
_REFUSALS = {
    kind.__name__: kind
    for kind in _OF_READING
    if isinstance(kind, type) and issubclass(kind, BadInput)
}


def read_upload(
    content: bytes,
    ending: str,
    name: str,
    *,
    memory: int,
    seconds: int,
    options: Mapping[str, object] | None = None,
    dbc: Path | None = None,
) -> Record:
    """The record of an uploaded file. `name` is what messages call it; the file's name on disk is
    ours; `options` are those of `ReadOptions`, as plain values; by `dbc` a CAN log is read.

    `memory` [bytes] and `seconds` (of processor time) limit the process that reads it. Raises what
    reading raises, with one line (BadRecord, BadUnit, …; for an NPZ also BadBody and TooLarge), and
    BadRecord when reading it exceeds a limit or ends the process.
    """
    how = {"options": options or {}, "unpacked": memory, "dbc": None if dbc is None else str(dbc)}
    return _read(content, ending, name, how, memory, seconds)


def read_body(content: bytes, kind: str, *, memory: int, seconds: int, unpacked: int) -> Record:
    """The record of a body of one of `FORMATS`, which may unpack to so many bytes; limits and
    refusals as of `read_upload`.
    """
    return _read(content, "", "body", {"kind": kind, "unpacked": unpacked}, memory, seconds)


def _read(
    content: bytes, ending: str, name: str, how: Mapping[str, object], memory: int, seconds: int
) -> Record:
    with tempfile.TemporaryDirectory(prefix="residuum-upload-") as folder:
        file = Path(folder) / f"upload{ending}"
        file.write_bytes(content)
        arguments = (str(file), orjson.dumps(how).decode())
        refusal = run_limited(__name__, arguments, file.parent, memory=memory, seconds=seconds)
        if refusal is not None:
            kind, parts = refusal
            # files of ours are no business of the sender, whose name the file has in every message
            for part in ("what", "rule"):
                parts[part] = parts.get(part, "").replace(str(file), name).replace(file.name, name)
            if not (kind and parts["what"].startswith(name)) and not parts["rule"]:
                parts["what"] = f"{name}: {parts['what']}"
            raise _REFUSALS.get(kind, BadRecord)(**parts)
        return _load(file, name)


def _load(file: Path, name: str) -> Record:
    record = load_plain(file.parent, name)
    return replace(record, notes=tuple(note.replace(file.name, name) for note in record.notes))


def _record(file: Path, how: Mapping[str, Any]) -> Record:
    # - within the limits
    from residuum.identification.record_formats import ReadOptions, read_record  # noqa: PLC0415
    from residuum.service.work.signal_formats import FORMATS, check_npz  # noqa: PLC0415

    if "kind" in how:
        return FORMATS[how["kind"]](file.read_bytes(), how["unpacked"])
    if how["dbc"] is not None:
        from residuum.service.fieldbus.can.can_record import read_can_record  # noqa: PLC0415

        return read_can_record(file, how["dbc"], ReadOptions(**how["options"]))
    if file.suffix == ".npz":
        with file.open("rb") as archive:
            check_npz(archive, how["unpacked"], str(file))
    return read_record(file, ReadOptions(**how["options"]))


def main(memory: int, seconds: int, name: str, described: str) -> int:
    """Read a file within the limits; gives the exit status."""
    file = Path(name)
    return within_limits(
        lambda: keep_plain(_record(file, orjson.loads(described)), file.parent), memory, seconds
    )


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), int(sys.argv[2]), *sys.argv[3:]))
