"""Whether FMUs may be run here that came with what somebody else stored: baselines may hold one."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from residuum.identification.errors import Forbidden

_ALLOWED = ContextVar("whether FMUs may be run that came with what was stored", default=False)


ARRAY = "fmu"
"""The array of a stored baseline that has the bytes of its FMU."""


def holds_fmu(path: str | Path) -> bool:
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
