"""Files whose readers are C code are read in a process of its own: a damaged one can end that
process, and nothing else.

SciPy's reader of MAT files and the one of MDF files have been ended by damaged files with a
segmentation fault, which no `except` sees. The process costs half a second; other formats are read
by Python, or by libraries that withstood mutated files.

As a program (`python -m residuum.identification.record_formats.read_apart FILE FOLDER OPTIONS`) it
leaves the record in FOLDER; a refusal is its class and its parts, JSON on standard output, and exit
status 2.
"""

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

from residuum.identification import errors
from residuum.identification.errors import BadInput, BadRecord
from residuum.identification.record import Record
from residuum.identification.record_formats import MAY_CRASH, read_record
from residuum.identification.record_formats.loggers.logger_mapping import (
    ENDING,
    read_logger_file,
    read_mapping,
)
from residuum.identification.record_formats.npz import keep_plain, load_plain
from residuum.identification.record_formats.options import ReadOptions

_REFUSED = 2
# where this package is found: the process imports the same one
_HERE = str(Path(__file__).resolve().parents[3])


def read_mapped(
    path: Path, options: ReadOptions = ReadOptions(), mapping: Path | None = None
) -> Record:
    """`read_safely`, or a logger's file by its mapping: the one that is named, or FILE.mapping.yaml
    beside it.
    """
    chosen = mapping or mapping_beside(path)
    return (
        read_safely(path, options)
        if chosen is None
        else read_logger_file(path, read_mapping(chosen), options)
    )


def mapping_beside(path: Path) -> Path | None:
    """The mapping that `residuum inspect --out` wrote beside a file."""
    beside = path.with_name(path.name + ENDING)
    return beside if beside.is_file() else None


def read_safely(path: str | Path, options: ReadOptions = ReadOptions()) -> Record:
    """`read_record`, in a process of its own where the file's reader is C code that a damaged file
    may end.

    Raises what `read_record` raises, and BadRecord where reading ended the process.
    """
    path = Path(path)
    # Half a second for a process is paid by these formats alone: two of a hundred thousand mutated
    # files ended SciPy's or asammdf's C code by a segmentation fault, which no `except` sees.
    if path.suffix.lower() not in MAY_CRASH or not path.is_file():
        return read_record(path, options)
    with tempfile.TemporaryDirectory(prefix="residuum-record-") as folder:
        arguments = json.dumps(asdict(options) | {"units": dict(options.units)})
        python_path = os.environ.get("PYTHONPATH")
        done = subprocess.run(
            [sys.executable, "-m", __name__, str(path), folder, arguments],
            env=os.environ
            | {"PYTHONPATH": _HERE + (os.pathsep + python_path if python_path else "")},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            check=False,
        )
        if done.returncode == 0:
            return load_plain(Path(folder), str(path))
    if done.returncode == _REFUSED and done.stdout:
        kind, parts = json.loads(done.stdout)
        # In parts, so that the way on is said in the words of the door that asked here.
        raise getattr(errors, kind, BadRecord)(**parts)
    raise BadRecord(
        f"{path}: reading it ended the process that did ({_ending(done.returncode)}): the file is"
        " damaged; save it anew"
    )


def _ending(status: int) -> str:
    return f"signal {-status}" if status < 0 else f"exit status {status}"


def main(file: str, folder: str, arguments: str) -> int:
    """Read a file and leave its record in the folder; gives the exit status."""
    # a library's chatter is no refusal
    out, sys.stdout = sys.stdout, sys.stderr
    try:
        keep_plain(read_record(file, ReadOptions(**json.loads(arguments))), Path(folder))
    except BadInput as error:
        json.dump([type(error).__name__, error.parts], out)
        out.flush()
        return _REFUSED
    except MemoryError:
        json.dump(
            ["BadRecord", {"what": f"{file}: reading it takes more memory than there is"}], out
        )
        out.flush()
        return _REFUSED
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
