"""Folders of compiled code: each belongs to the user who runs this program, and nobody else can put
anything there.

What lies there is loaded and run, so whoever may write there may do as this user may.
"""

from __future__ import annotations

import atexit
import os
import shutil
import stat
import tempfile
import warnings
from functools import lru_cache
from pathlib import Path

_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH


def code_folder(name: str, variable: str) -> Path:
    """The folder `name` of compiled code, made where it is missing, with mode 0700.

    It is in the folder that the environment's `variable` names, else in `~/.cache/residuum`, else
    among the temporary files. One that is not ours alone, or that lies where others may exchange
    it, is never used: what is compiled is then forgotten at this process's end, and a
    RuntimeWarning says why.
    """
    folder, why = _found(name, os.environ.get(variable))
    if why is not None:
        warnings.warn(
            f"compiled code is not kept: {why}; {variable} names another folder",
            RuntimeWarning,
            stacklevel=2,
        )
    return folder


def why_not_kept(name: str, variable: str) -> str | None:
    """Why the compiled code `name` is forgotten at this process's end, None when it is kept."""
    return _found(name, os.environ.get(variable))[1]


@lru_cache(maxsize=16)
def _found(name: str, chosen: str | None) -> tuple[Path, str | None]:
    """The folder, and why it is one that nothing is kept in."""
    why = "no folder can be written"
    ours = Path(chosen) if chosen else Path.home() / ".cache" / "residuum"
    # The user's own folder first, the temporary ones where that cannot be written.
    for place in (Path(tempfile.gettempdir()) / f"residuum-{os.getuid()}", ours)[::-1]:
        folder = (place / name).absolute()
        try:
            _make_closed(folder)
            wrong = why_not_private(folder)
            if wrong is not None:
                # No other place is tried: the warning is to name the one that is wrong.
                why = wrong
                break
            # It may be there already, made under another umask.
            folder.chmod(0o700)
            # A folder of a full or read-only disk is there as well, and takes no file.
            tempfile.TemporaryFile(dir=folder).close()
            return folder, None
        except OSError:
            continue  # nothing can be written there: the next place
    forgotten, process = Path(tempfile.mkdtemp(prefix="residuum-")), os.getpid()
    atexit.register(_forget, forgotten, process)
    return forgotten, why


def _make_closed(folder: Path) -> None:
    """Make a folder and what is missing above it, each with mode 0700: `mkdir(parents=True)` leaves
    those above to the umask.
    """
    if not folder.is_dir():
        if folder != folder.parent:
            _make_closed(folder.parent)
        folder.mkdir(mode=0o700, exist_ok=True)


def _forget(folder: Path, process: int) -> None:
    """Remove a folder at the end of the process that made it, not of those that it forked."""
    if process == os.getpid():
        shutil.rmtree(folder, ignore_errors=True)


def why_not_private(folder: Path) -> str | None:
    """Why somebody else could put code into a folder, None when nobody but this user and root can.

    The folder must be this user's; each folder above it this user's or root's, and closed to others
    or sticky as `/tmp` is.
    """
    if folder.is_symlink() or folder.stat().st_uid != os.getuid():
        return f"{folder} belongs to another user"
    for above in folder.resolve().parents:
        status = above.stat()
        if status.st_uid not in (0, os.getuid()):
            return f"{folder} lies in {above}, which belongs to another user"
        # Where the sticky bit is set (/tmp) others may write, but not exchange what is ours.
        if status.st_mode & _OTHERS_WRITE and not status.st_mode & stat.S_ISVTX:
            return f"{folder} lies in {above}, in which others may write"
    return None
