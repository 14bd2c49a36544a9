"""Files that are there whole, or as they were before."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from residuum.identification.errors import BadInput


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file, a text as UTF-8, so that it is there whole, or as it was before.

    Raises
    ------
    BadInput
        The folder does not exist, or the name is a folder's.
    """
    if not path.parent.is_dir():
        raise BadInput(f"{path}: folder {str(path.parent)!r} does not exist")
    if path.is_dir():
        raise BadInput(f"{path}: is a folder; give the name of a file")
    # In the same folder: a file is replaced at once only within one file system.
    handle, part = tempfile.mkstemp(dir=path.parent, prefix=path.name, suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content.encode() if isinstance(content, str) else content)
        # A temporary file is its owner's alone; the file gets the mode of any other that is
        # written.
        os.chmod(part, 0o666 & ~_umask())
        os.replace(part, path)
    except BaseException:
        os.unlink(part)
        raise


def _umask() -> int:
    # It can be read only by setting it.
    mask = os.umask(0o022)
    os.umask(mask)
    return mask
