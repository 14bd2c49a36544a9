"""Folders that are there after a power cut: an entry is on disk only when the folder that holds it
has been synced.
"""

from __future__ import annotations

import os
from pathlib import Path


def make_folder(folder: Path) -> None:
    """Make a folder, and those above it that are missing, and return when they are on disk."""
    missing = [folder] if not folder.is_dir() else []
    while missing and not missing[-1].parent.is_dir():
        missing.append(missing[-1].parent)
    # From the top down: where only the lowest folder was synced, a power cut took the folders above
    # it, and with them all that they held (counted by `python -m benchmarks.power_cut`).
    for path in reversed(missing):
        path.mkdir(exist_ok=True)
        sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Return when the entries of a folder are on disk."""
    # A folder can be opened for reading only; fsync needs no more.
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def keep_file(file: Path, content: bytes) -> None:
    """Write a file in a folder that is there, and return when it is on disk: a file of this name is
    whole, also after a power cut. What is left of one that was not finished ends with `.part`.
    """
    part = file.with_name(f"{file.name}.part")
    with part.open("wb") as opened:
        opened.write(content)
        opened.flush()
        os.fsync(opened.fileno())
    part.replace(file)
    sync_folder(file.parent)
