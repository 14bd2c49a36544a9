"""Uploaded files are read in a process of their own, with limits on memory, time, files and output: a hostile or broken file
can end that process, and nothing else.

As a program (`python -m residuum.service.work.upload_reader FILE MEMORY SECONDS`) it reads FILE and leaves the record beside it
as plain arrays with a description in JSON; a refusal is one line on standard output and exit status 2.
"""

from __future__ import annotations

import contextlib
import os
import resource
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import numpy as np
import orjson

from residuum.identification.errors import BadInput, BadRecord
from residuum.identification.record import Record

_REFUSED = 2
_DESCRIPTION = "record.json"
_FILES = 64
_PATIENCE = 3
"""Waiting time a second of processor time: a busy machine gives less than one processor."""
_MOST_AT_ONCE = threading.BoundedSemaphore(2)


def read_upload(content: bytes, ending: str, name: str, *, memory: int, seconds: int) -> Record:
    """The record of an uploaded file. `name` is what messages call it; the file's name on disk is ours.

    `memory` [bytes] and `seconds` (of processor time) limit the process that reads it. Two are read at once, others wait.
    Raises BadRecord with one line when the file is refused, or when reading it exceeds a limit or ends the process.
    """
    with tempfile.TemporaryDirectory(prefix="residuum-upload-") as folder:
        file = Path(folder) / f"upload{ending}"
        file.write_bytes(content)
        with _MOST_AT_ONCE:
            refusal = _read_apart(file, memory, seconds)
        if refusal is not None:
            raise BadRecord(refusal.replace(str(file), name) if str(file) in refusal else f"{name}: {refusal}")
        return _load(file.parent, name)


def _read_apart(file: Path, memory: int, seconds: int) -> str | None:
    """Why the file cannot be read, None when it was."""
    command = [sys.executable, "-P", "-m", __name__, str(file), str(memory), str(seconds)]
    threads = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    kept = {name: os.environ[name] for name in ("PATH", "PYTHONPATH", "LANG") if name in os.environ}
    try:
        done = subprocess.run(
            command,
            env=kept | threads | {"TMPDIR": str(file.parent)},  # libraries leave files there when they fail
            cwd=file.parent,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=_PATIENCE * seconds,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"reading it takes longer than {_PATIENCE * seconds} s"
    if done.returncode == 0:
        return None
    if done.returncode == _REFUSED:
        return done.stdout.decode("utf-8", "replace")
    return f"reading it ended the process that did ({done.returncode}); at most {memory} bytes and {seconds} s are given"


def _load(folder: Path, name: str) -> Record:
    described = orjson.loads((folder / _DESCRIPTION).read_bytes())
    names = list(described["units"])
    channels = {each: np.load(folder / f"{number}.npy", allow_pickle=False) for number, each in enumerate(names)}
    return Record(
        channels, described["units"], described["sample_time"], described["t0"], notes=tuple(described["notes"]), source=name
    )


def _keep(record: Record, folder: Path) -> None:
    for number, each in enumerate(record.names):
        np.save(folder / f"{number}.npy", record[each], allow_pickle=False)
    units = {each: record.units[each] for each in record.names}
    described = {"units": units, "sample_time": record.sample_time, "t0": record.t0, "notes": list(record.notes)}
    (folder / _DESCRIPTION).write_bytes(orjson.dumps(described))


def _limit(memory: int, seconds: int) -> None:
    limits = {
        resource.RLIMIT_DATA: memory,
        resource.RLIMIT_CPU: seconds,
        resource.RLIMIT_NOFILE: _FILES,
        resource.RLIMIT_FSIZE: memory,
        resource.RLIMIT_CORE: 0,
    }
    for kind, most in limits.items():
        resource.setrlimit(kind, (most, most))


def main(name: str, memory: int, seconds: int) -> int:
    """Read a file within the limits; gives the exit status. They stay: this is for a process of its own."""
    _limit(memory, seconds)
    file = Path(name)
    try:
        from residuum.identification.record_formats import read_record  # noqa: PLC0415 - within the limits

        with contextlib.redirect_stdout(sys.stderr):  # a library's chatter is no refusal
            record = read_record(file)
        _keep(record, file.parent)
    except BadInput as error:
        sys.stdout.buffer.write(str(error).encode("utf-8", "replace"))
        return _REFUSED
    except MemoryError:
        sys.stdout.write(f"reading it takes more than {memory} bytes of memory")
        return _REFUSED
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3])))
