"""Records as NPZ: one array a channel, `sample_time`, and `units` as JSON."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import IO, Any, Protocol

import numpy as np
import numpy.typing as npt
from numpy.lib import format as npy

from residuum.identification.errors import BadRecord, in_one_line
from residuum.identification.record import Record
from residuum.identification.record_formats.options import ReadOptions

# A record as plain arrays in a folder, beside a description in JSON: how one process hands it to
# another.

_DESCRIPTION = "record.json"


def keep_plain(record: Record, folder: Path) -> None:
    """Write a record's channels, one `.npy` file each, and its description into a folder that is
    there.
    """
    for number, name in enumerate(record.names):
        # By number: what a channel may be called is not always the name of a file.
        np.save(folder / f"{number}.npy", record[name], allow_pickle=False)
    units = {name: record.units[name] for name in record.names}
    described = {
        "units": units,
        "sample_time": record.sample_time,
        "t0": record.t0,
        "notes": list(record.notes),
    }
    (folder / _DESCRIPTION).write_text(json.dumps(described), encoding="utf-8")


def load_plain(folder: Path, source: str) -> Record:
    """The record that `keep_plain` wrote there; nothing is unpickled."""
    described = json.loads((folder / _DESCRIPTION).read_text(encoding="utf-8"))
    names = list(described["units"])
    channels = {
        name: np.load(folder / f"{number}.npy", allow_pickle=False)
        for number, name in enumerate(names)
    }
    units, notes = described["units"], tuple(described["notes"])
    return Record(
        channels, units, described["sample_time"], described["t0"], notes=notes, source=source
    )


class Described(Protocol):
    """What a record says of its samples."""

    @property
    def sample_time(self) -> float:
        """[s]."""

    @property
    def t0(self) -> float:
        """[s]."""

    @property
    def n(self) -> int:
        """Samples of each channel."""

    @property
    def units(self) -> Mapping[str, str]:
        """By channel."""

    @property
    def notes(self) -> Sequence[str]:
        """What is worth knowing of it."""


# entries of the archive that are no channels
_RESERVED = ("sample_time", "units", "t0", "notes")


def read_npz(path: str | Path, options: ReadOptions = ReadOptions()) -> Record:
    """Read a record from an NPZ file. Object arrays are refused (nothing is ever unpickled).

    Raises BadRecord when the file is no NPZ, or `sample_time` or `units` is absent or malformed.
    """
    try:
        # NumPy leaves a file open that it opened itself and cannot read.
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as archive:
            stored: dict[str, Any] = {name: archive[name] for name in archive.files}
    except (OSError, ValueError, zipfile.BadZipFile, EOFError) as error:
        raise BadRecord(
            f"{path}: is not an NPZ file of plain arrays: {in_one_line(error)}"
        ) from None
    step = _scalar(stored["sample_time"], "sample_time", path) if "sample_time" in stored else None
    channels = {name: array for name, array in stored.items() if name not in _RESERVED}
    return Record(
        channels,
        {
            name: options.unit_of(name, unit)
            for name, unit in _units(stored.get("units"), channels, path).items()
        },
        sample_time=options.settle_sample_time(step, str(path)),
        t0=_scalar(stored.get("t0", np.array(0.0)), "t0", path),
        notes=tuple(
            str(note) for note in np.atleast_1d(stored.get("notes", np.array([], dtype=str)))
        ),
        source=str(path),
    )


def write_npz(
    record: Record, path: str | Path | IO[bytes], compression: int = zipfile.ZIP_DEFLATED
) -> None:
    """Write a record so that `read_npz` gives it back exactly; `compression` is one of `zipfile`."""
    dtypes = {name: signal.dtype.str for name, signal in record.channels.items()}
    write_npz_in_pieces(path, record, dtypes, lambda name: (record[name],), compression)


def write_npz_in_pieces(
    path: str | Path | IO[bytes],
    described: Described,
    dtypes: Mapping[str, str],
    pieces: Callable[[str], Iterable[npt.NDArray[Any]]],
    compression: int = zipfile.ZIP_DEFLATED,
) -> None:
    """Write a record whose samples come piece by piece, for each channel of `dtypes`, so that they
    are never held as a whole.
    """
    extra: dict[str, Any] = {
        "sample_time": np.float64(described.sample_time),
        "t0": np.float64(described.t0),
        "units": np.array(json.dumps(dict(described.units))),
        "notes": np.array(described.notes, dtype=str),
    }
    if clash := set(extra) & set(dtypes):
        raise BadRecord(f"{path}: a channel cannot be called {sorted(clash)[0]!r} in an NPZ record")
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, dtype in dtypes.items():
            # The length of an entry stands before it: one that may outgrow 2 GiB has to be
            # announced.
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                header = {"descr": dtype, "fortran_order": False, "shape": (described.n,)}
                npy.write_array_header_1_0(file, header)
                for piece in pieces(name):
                    file.write(np.ascontiguousarray(piece).data)
        for name, value in extra.items():
            with archive.open(f"{name}.npy", "w") as file:
                npy.write_array(file, np.asanyarray(value), allow_pickle=False)


def _scalar(array: Any, name: str, path: str | Path) -> float:
    try:
        return float(array)
    except (TypeError, ValueError):
        raise BadRecord(f"{path}: {name!r} must be one number") from None


def _units(stored: Any, channels: dict[str, Any], path: str | Path) -> dict[str, str]:
    if stored is None:
        # Plain arrays say no units, which is not to say that they are pure numbers.
        return dict.fromkeys(channels, "")
    try:
        units = json.loads(str(stored))
    except json.JSONDecodeError:
        units = None
    if not isinstance(units, dict):
        raise BadRecord(f"{path}: 'units' must be a JSON object of channel name to unit")
    return {name: str(units.get(name, "")) for name in channels}
