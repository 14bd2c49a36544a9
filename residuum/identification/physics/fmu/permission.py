"""Whether FMUs may be run here that came with what somebody else stored: baselines may hold one."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import IO, TypeGuard

from residuum.identification.errors import BadModel, Forbidden

_ALLOWED = ContextVar("whether FMUs may be run that came with what was stored", default=False)


ARRAY = "fmu"
"""The array of a stored baseline that has the bytes of its FMU."""


LARGEST = 64 << 20
"""Bytes of an FMU that a baseline holds: more is data, or libraries for platforms that no machine
of the plant has.
"""


def check_size(file: Path, named: str | None = None) -> None:
    """Raise BadModel for an FMU that no baseline could hold; `named` is what it is called by."""
    size = file.stat().st_size
    if size > LARGEST:
        raise BadModel(
            f"model {named or str(file)!r}: has {size >> 20} MiB; a baseline holds its FMU, of at"
            f" most {LARGEST >> 20} MiB: export it without data and sources, for the platforms"
            " that judge"
        )


_PACKED = b"PK\x03\x04"


def is_packed(content: bytes | None) -> TypeGuard[bytes]:
    """Whether what is stored as a model is an FMU: the text of a model file never begins as a
    packed file does.
    """
    return content is not None and content.startswith(_PACKED)


def holds_fmu(path: str | Path | IO[bytes]) -> bool:
    """Whether a file is a stored baseline with an FMU in it."""
    try:
        if not zipfile.is_zipfile(path):
            return False
        with zipfile.ZipFile(path) as archive:
            return f"arrays/{ARRAY}.npy" in archive.namelist()
    except (OSError, ValueError, zipfile.BadZipFile, NotImplementedError):
        return False  # who reads it refuses it


@contextmanager
def fmus_allowed(allowed: bool = True) -> Iterator[None]:
    """Read baselines that hold an FMU meanwhile, whose code then runs in this process."""
    before = _ALLOWED.set(allowed)
    try:
        yield
    finally:
        _ALLOWED.reset(before)


def check_allowed(source: str) -> None:
    """Raise Forbidden where nobody allowed it; `source` is what holds the FMU."""
    if not _ALLOWED.get():
        raise Forbidden(
            f"{source}: holds an FMU, which is native code, and nobody allowed it here: `residuum"
            " score` runs it in a process of its own, a service with its setting allow_fmus, Python"
            " with rs.load_monitor(…, allow_fmus=True)"
        )
