"""What Residuum reads records from: files, by the ending of their names, and tables of a history,
by their address; and what it writes.
"""

from collections.abc import Callable
from pathlib import Path

from residuum.identification.errors import BadInput, BadRecord, in_one_line
from residuum.identification.record import Record
from residuum.identification.record_formats.csv import parse_csv, read_csv, write_csv
from residuum.identification.record_formats.histories import is_history, read_history
from residuum.identification.record_formats.loggers.no_value import without_marks, without_overloads
from residuum.identification.record_formats.lvm import read_lvm
from residuum.identification.record_formats.mat import read_mat, write_mat
from residuum.identification.record_formats.mdf import read_mdf, write_mdf
from residuum.identification.record_formats.npz import read_npz, write_npz
from residuum.identification.record_formats.options import ReadOptions
from residuum.identification.record_formats.parquet import read_parquet, write_parquet
from residuum.identification.record_formats.tdms import read_tdms, write_tdms
from residuum.identification.record_formats.uff import read_uff, write_uff
from residuum.identification.record_formats.wav import read_wav, write_wav
from residuum.nearest_names import known_names

READERS: dict[str, Callable[[str | Path, ReadOptions], Record]] = {
    ".csv": read_csv,
    ".npz": read_npz,
    ".mat": read_mat,
    ".wav": read_wav,
    ".parquet": read_parquet,
    ".tdms": read_tdms,
    ".mf4": read_mdf,
    ".uff": read_uff,
}
LOGGERS = {**dict.fromkeys((".txt", ".tsv", ".dat"), read_csv), ".lvm": read_lvm}
"""What loggers call their text files; nothing is written under these endings."""
OLDER = {".mdf": read_mdf}
"""Formats of earlier days, read only."""
MAY_CRASH = (".mat", ".mf4", ".mdf")
"""Formats whose readers a damaged file can end with a segmentation fault (see `read_apart`)."""
CAN_LOGS = (".blf", ".asc", ".log", ".trc")
"""Logs of CAN buses: a DBC file says what is in them, and the service, which knows buses, reads
them.
"""
WRITERS: dict[str, Callable[[Record, str | Path], None]] = {
    ".csv": write_csv,
    ".npz": write_npz,
    ".mat": write_mat,
    ".wav": write_wav,
    ".parquet": write_parquet,
    ".tdms": write_tdms,
    ".mf4": write_mdf,
    ".uff": write_uff,
}

# characters of a refusal: some libraries repeat the file in it
_LONGEST = 1000


def read_record(path: str | Path, options: ReadOptions = ReadOptions()) -> Record:
    """Read a record file, whose ending says the format, a table of a history (`timescale://` or
    `influx://host/database/table?tags=a,b`), or nodes of an OPC UA server that keeps their
    history (`opc.tcp://host:4840?nodes=ns=2;s=Speed&start=2026-03-01&end=2026-03-08`).

    Raises BadRecord for an ending that is not listed, a file that is not there, and a file that the
    format's reader refuses or breaks on: what a library raises for a damaged file is of any kind,
    and only sometimes one line.
    """
    # Before a `Path` is made of it, which keeps one of an address's two slashes.
    if is_history(path):
        return read_history(str(path), options)
    path = Path(path)
    ending = path.suffix.lower()
    reader = (READERS | LOGGERS | OLDER).get(ending)
    if ending in CAN_LOGS:
        raise BadRecord(f"{path}: is a CAN log; the commands read it, with the DBC file of its bus")
    if reader is None:
        raise BadRecord(
            f"{path}: ending {ending!r} is not a record format;"
            f" {known_names(ending, [*READERS, *LOGGERS, *OLDER])}"
        )
    if not path.is_file():
        raise BadRecord(f"{path}: no such file")
    try:
        return without_overloads(without_marks(reader(path, options), options.missing))
    except BadInput as error:
        if "\n" not in str(error) and len(str(error)) <= _LONGEST:
            raise
        raise BadRecord(" ".join(str(error).split())[:_LONGEST]) from None
    # No fault of the file's: the process that reads it has little memory, and answers for that.
    except MemoryError:
        raise
    # Damaged files end readers with their own, struct's, NumPy's and zlib's errors.
    except Exception as error:
        raise BadRecord(
            f"{path}: is damaged or not a {ending} file ({in_one_line(error)})"
        ) from error


def write_record(record: Record, path: str | Path) -> None:
    """Write a record file in the format that the ending names; a failed write leaves no file
    behind.
    """
    path = Path(path)
    ending = path.suffix.lower()
    if ending not in WRITERS:
        raise BadRecord(
            f"{path}: ending {ending!r} cannot be written; {known_names(ending, WRITERS)}"
        )
    if not path.parent.is_dir():
        raise BadRecord(f"{path}: folder {str(path.parent)!r} does not exist")
    WRITERS[ending](record, path)


__all__ = [
    "CAN_LOGS",
    "LOGGERS",
    "MAY_CRASH",
    "OLDER",
    "READERS",
    "WRITERS",
    "ReadOptions",
    "parse_csv",
    "read_record",
    "write_record",
]
