"""A digest of code: what was made by some code is right as long as its digest stays."""

from __future__ import annotations

import hashlib
import sys
from functools import lru_cache
from importlib import import_module
from importlib.resources import files
from importlib.resources.abc import Traversable

# Sources, models and effects in YAML, CAN databases; what is compiled or cached follows from them.
_MADE_OF = (".py", ".yaml", ".dbc")


@lru_cache(maxsize=8)
def code_digest(package: str) -> str:
    """SHA-256 of this Python and of every source and data file of an imported package, by place
    within it and content.

    A package is named, never a file: names of files move, and a package that moved is an import
    that fails where it is read.

    Parameters
    ----------
    package : str
        Its full name, `residuum.identification.physics`.

    Returns
    -------
    str
        Hexadecimal; 64 characters.

    Raises
    ------
    ModuleNotFoundError
        No package has this name.
    """
    digest = hashlib.sha256(sys.version.encode())
    _add(digest, files(import_module(package)), "")
    return digest.hexdigest()


def _add(digest: hashlib._Hash, folder: Traversable, place: str) -> None:
    # A folder is listed in no order, on which the digest must not hang.
    for entry in sorted(folder.iterdir(), key=lambda child: child.name):
        inside = f"{place}/{entry.name}"
        if entry.is_dir():
            _add(digest, entry, inside)
        elif entry.name.endswith(_MADE_OF):
            # With its place: two files that exchange their contents are other code.
            digest.update(inside.encode() + b"\0" + entry.read_bytes())
