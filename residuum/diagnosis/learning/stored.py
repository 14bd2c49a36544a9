"""What a trained diagnoser is stored as: a zip of JSON, NumPy arrays and skops estimators; never
pickle.
"""

from __future__ import annotations

import io
import json
import os
import tempfile
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from residuum.identification.errors import BadInput
from residuum.identification.npy_header import npy_header

_FORMAT = "residuum-diagnoser"
_HEADER = "header.json"
# bytes unpacked; a stored diagnoser is kilobytes, so more is a damaged or hostile file
_LARGEST = 1 << 30
_READABLE = "fiub?"
_UNREADABLE = (
    zipfile.BadZipFile,
    zlib.error,
    KeyError,
    ValueError,
    TypeError,
    EOFError,
    OSError,
    RuntimeError,
    NotImplementedError,
)
"""What reading a file that is none of ours may raise: encrypted and unknown compression too."""


@dataclass(frozen=True)
class Stored:
    """Content of a stored diagnoser: `kind` (its name), format `version`, `meta` (JSON), arrays and
    estimators by name.
    """

    kind: str
    version: int
    meta: dict[str, Any]
    arrays: dict[str, npt.NDArray[Any]] = field(default_factory=dict)
    estimators: dict[str, Any] = field(default_factory=dict)


def save_stored(
    path: str | Path,
    kind: str,
    version: int,
    meta: Mapping[str, Any],
    arrays: Mapping[str, npt.ArrayLike] | None = None,
    estimators: Mapping[str, Any] | None = None,
) -> None:
    """Write a diagnoser to `path`, whole or not at all (a temporary file beside it is renamed over
    it).

    Parameters
    ----------
    path : file to write; its folder must exist
    kind : str
        Name of the diagnoser; `load_stored` refuses a file of another kind.
    version : int
        Version of the diagnoser's own content.
    meta : JSON-able mapping
    arrays : numeric or boolean arrays by name
    estimators : scikit-learn estimators by name, stored by skops

    Raises
    ------
    BadInput
        The folder does not exist or cannot be written.
    """
    path = Path(path)
    header = json.dumps(
        {"format": _FORMAT, "kind": kind, "version": version, "meta": meta},
        allow_nan=False,
        indent=1,
    )
    try:
        descriptor, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    except OSError as error:
        raise BadInput(f"{path}: cannot be written: {error.strerror}") from None
    try:
        with os.fdopen(descriptor, "wb") as file:
            with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
                archive.writestr(_HEADER, header)
                for name, array in (arrays or {}).items():
                    archive.writestr(f"arrays/{name}.npy", _to_npy(array))
                for name, estimator in (estimators or {}).items():
                    archive.writestr(f"estimators/{name}.skops", _skops().dumps(estimator))
            file.flush()
            os.fsync(file.fileno())
        Path(temporary).chmod(0o644)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def load_stored(path: str | Path, kind: str) -> Stored:
    """Read a diagnoser that `save_stored` wrote.

    Raises
    ------
    BadInput
        No such file, not a stored diagnoser, of another kind, damaged, or it holds an estimator of
        a type that is not known to be safe. Nothing of the file is executed.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "a.model"
    ...     save_stored(path, "bearing", 1, {"rate": 12000.0}, {"mean": [1.0, 2.0]})
    ...     stored = load_stored(path, "bearing")
    >>> stored.meta["rate"], stored.arrays["mean"].tolist()
    (12000.0, [1.0, 2.0])
    """
    path = Path(path)
    if not path.is_file():
        raise BadInput(f"{path}: no such file")
    try:
        with zipfile.ZipFile(path) as archive:
            if sum(info.file_size for info in archive.infolist()) > _LARGEST:
                raise BadInput(
                    f"{path}: unpacks to more than {_LARGEST >> 20} MiB; is not a stored diagnoser;"
                    " `residuum train` writes one"
                )
            return _read(archive, str(path), kind)
    except _UNREADABLE as error:
        if isinstance(error, BadInput):
            raise
        raise BadInput(
            f"{path}: is not a stored diagnoser, as `residuum train` writes one:"
            f" {' '.join(str(error).split())[:120]}"
        ) from None


def stored_kind(path: str | Path) -> str | None:
    """The kind of a file that `save_stored` wrote; None for any other file."""
    try:
        with zipfile.ZipFile(path) as archive:
            header = json.loads(archive.read(_HEADER))
    except _UNREADABLE:
        return None
    return (
        str(header.get("kind"))
        if isinstance(header, dict) and header.get("format") == _FORMAT
        else None
    )


def _read(archive: zipfile.ZipFile, path: str, kind: str) -> Stored:
    header = json.loads(archive.read(_HEADER))
    if not isinstance(header, dict) or header.get("format") != _FORMAT:
        raise BadInput(f"{path}: is not a stored diagnoser; `residuum train` writes one")
    if header["kind"] != kind:
        raise BadInput(f"{path}: holds a {header['kind']!r} diagnoser; {kind!r} is needed")
    stored = Stored(kind, int(header["version"]), dict(header["meta"]))
    for name in archive.namelist():
        folder, _, member = name.partition("/")
        if folder == "arrays":
            stored.arrays[member.removesuffix(".npy")] = _from_npy(
                archive.read(name), f"{path}, array {member!r}"
            )
        elif folder == "estimators":
            stored.estimators[member.removesuffix(".skops")] = _estimator(
                archive.read(name), f"{path}, estimator {member!r}"
            )
    return stored


def _to_npy(array: npt.ArrayLike) -> bytes:
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, np.ascontiguousarray(array), allow_pickle=False)
    return buffer.getvalue()


def _from_npy(data: bytes, where: str) -> npt.NDArray[Any]:
    """The array in `data`; its header is held against the bytes there are before anything is
    allocated.
    """
    header = npy_header(data)
    if (
        header.dtype.kind not in _READABLE
        or header.fortran_order
        or header.size != len(data) - header.start
    ):
        raise BadInput(
            f"{where}: header says {header.dtype} {header.shape}, which the member does not hold"
        )
    return np.frombuffer(data, header.dtype, offset=header.start).reshape(header.shape).copy()


def _estimator(data: bytes, where: str) -> Any:
    skops = _skops()
    if unsafe := skops.get_untrusted_types(data=data):
        raise BadInput(f"{where}: holds types that are not known to be safe: {', '.join(unsafe)}")
    return skops.loads(data)


def _skops() -> Any:
    """What stores estimators, imported where there is one: it imports all of scikit-learn, which
    takes seconds.
    """
    return import_module("skops.io")
