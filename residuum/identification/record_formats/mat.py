"""Records as MATLAB MAT files, version 5 (SciPy) and 7.3 (HDF5, extra `formats`)."""

from pathlib import Path
from typing import Any

import numpy as np
import scipy

from residuum.identification.errors import BadRecord
from residuum.identification.record import Record
from residuum.identification.record_formats.even_time import even_columns
from residuum.identification.record_formats.options import ReadOptions

_TIME = ("time", "t", "Time")
_RATE = ("fs", "Fs", "FS", "sampling_rate", "sr", "SR", "rate")
_STEP = ("sample_time", "Ts", "dt")
_HDF5 = b"\x89HDF\r\n\x1a\n"
_SHORTEST = 3


def read_mat(path: str | Path, options: ReadOptions = ReadOptions()) -> Record:
    """Read every numeric vector of the file (structs are searched) that has the length most of them share.

    Sample time comes from a vector `time`, a scalar `sample_time`/`Ts`/`dt`, a scalar `fs`/`Fs`/`sampling_rate`, or
    `options.sample_time`; units from `units_<channel>` strings or `options.units`.

    Raises BadRecord when the file is no MAT file, holds no vector, or says no sample time.
    """
    variables = _flatten(_load(path))
    vectors = {name: np.ravel(value) for name, value in variables.items() if _is_vector(value)}
    if not vectors:
        raise BadRecord(f"{path}: holds no numeric vector of at least {_SHORTEST} samples")
    length = max(vectors.values(), key=len).shape[0]
    vectors = {name: vector for name, vector in vectors.items() if vector.shape[0] == length}
    time = next((vectors.pop(name) for name in _TIME if name in vectors), None)
    if not vectors:
        raise BadRecord(f"{path}: holds time but no channel of its length")
    t0 = 0.0
    found = _scalar_step(variables)
    if time is not None:
        table = np.stack([time.astype(float), *(vector.astype(float) for vector in vectors.values())])
        found, table = even_columns(table, str(path), resample=options.resample)
        t0, vectors = float(table[0][0]), dict(zip(vectors, table[1:], strict=True))
    units = {name: options.unit_of(name, str(variables.get(f"units_{name}", ""))) for name in vectors}
    return Record(vectors, units, options.settle_sample_time(found, str(path)), t0=t0, source=str(path))


def write_mat(record: Record, path: str | Path) -> None:
    """Write a MAT file of version 5 that `read_mat` gives back: channels, `sample_time`, `units_<channel>`."""
    content: dict[str, Any] = {name: np.asarray(signal)[:, None] for name, signal in record.channels.items()}
    content |= {f"units_{name}": unit for name, unit in record.units.items() if unit}
    scipy.io.savemat(path, content | {"time": record.time[:, None]}, long_field_names=True)


def _load(path: str | Path) -> dict[str, Any]:
    try:
        with open(path, "rb") as file:
            is_hdf5 = _HDF5 in file.read(1024)
        return _load_hdf5(path) if is_hdf5 else scipy.io.loadmat(path, squeeze_me=True, simplify_cells=True)
    except (
        OSError,
        ValueError,
        TypeError,
        scipy.io.matlab.MatReadError,
        NotImplementedError,
        KeyError,
        EOFError,
        MemoryError,
    ) as error:
        raise BadRecord(f"{path}: is not a MAT file: {' '.join(str(error).split())[:120]}") from None


def _load_hdf5(path: str | Path) -> dict[str, Any]:
    try:
        import h5py  # noqa: PLC0415  optional: the extra `formats`
    except ImportError:
        raise BadRecord(f"{path}: MAT version 7.3 needs the extra 'formats'") from None
    found: dict[str, Any] = {}

    def keep(name: str, node: Any) -> None:
        if isinstance(node, h5py.Dataset) and node.dtype.kind in "fiu" and not name.startswith("#refs#"):
            is_text = node.attrs.get("MATLAB_class") == b"char"
            value = node[()]
            found[name.replace("/", ".")] = "".join(map(chr, np.ravel(value))) if is_text else np.squeeze(value)

    with h5py.File(path, "r") as file:
        file.visititems(keep)
    return found


def _flatten(variables: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Struct fields under their own name where it is free, else under `struct.field`."""
    flat: dict[str, Any] = {}
    for name, value in variables.items():
        if name.startswith("__"):
            continue
        if isinstance(value, dict):
            for inner, item in _flatten(value, f"{prefix}{name}.").items():
                short = inner.rsplit(".", 1)[-1]
                flat[short if short not in flat and short not in variables else inner] = item
        else:
            flat[prefix + name if prefix else name] = value
    return flat


def _is_vector(value: Any) -> bool:
    return (
        isinstance(value, np.ndarray) and value.dtype.kind in "fiu" and value.size >= _SHORTEST and value.size == max(value.shape)
    )


def _scalar_step(variables: dict[str, Any]) -> float | None:
    scalars = {
        name: float(value)
        for name, value in variables.items()
        if np.ndim(value) == 0 and isinstance(value, int | float | np.number)
    }
    for name in _STEP:
        if scalars.get(name, 0.0) > 0:
            return scalars[name]
    return next((1.0 / scalars[name] for name in _RATE if scalars.get(name, 0.0) > 0), None)
