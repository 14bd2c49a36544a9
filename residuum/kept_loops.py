"""Compiled loops, kept on disk until anything that they are made of changes.

Numba's own cache looks at the file of a loop alone, so a loop that calls one of another file, or
holds a constant of another file, would go on with the old one after an update in place. Here the
stamp of a loop is a digest of its file and of every file of this package that it imports, directly
or through others. What was compiled is kept by that digest and not by the folder that the package
lies in, so a copy of the package, or one that moved, compiles nothing again. The oldest go, so
nothing piles up.
"""

# mypy: disable-error-code="misc,no-untyped-call"

from __future__ import annotations

import hashlib
import os
import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

import numba
from numba.core.caching import CompileResultCacheImpl, FunctionCache, InTreeCacheLocator

from residuum.code_folder import code_folder

_ROOT = Path(__file__).parents[1]
_IMPORT = re.compile(
    r"^\s*(?:from (residuum[\w.]*) import (\([^)]*\)|.*)|import (residuum[\w.]*))", re.MULTILINE
)
_NAME = re.compile(r"\w+")
# Versions of a file whose loops stay compiled: the installed one, and checkouts beside it. Chosen.
_KEPT = 4


def njit(**options: Any) -> Callable[[Any], Any]:
    """`numba.njit(**options)`, kept on disk: in `$NUMBA_CACHE_DIR`, else in
    `~/.cache/residuum/loops`.

    Without the interpreter's lock unless asked otherwise: in a service a long loop would hold up
    everybody.
    """

    def kept(function: Any) -> Any:
        # Without the interpreter's lock: searches run simulations side by side in threads.
        loop = numba.njit(**{"nogil": True, **options})(function)
        loop._cache = _KeptLoop(function)
        return loop

    return kept


@lru_cache(maxsize=1024)
def made_of(file: Path) -> str:
    """A digest of a file of this package and of all files of it that this one imports, directly or
    through others.
    """
    digest = hashlib.sha256()
    for source_file in sorted(_reached(file)):
        digest.update(_content(source_file))
    return digest.hexdigest()


def _reached(file: Path) -> set[Path]:
    files, waiting = {file}, [file]
    while waiting:
        for imported in _imported(waiting.pop()):
            if imported not in files:
                files.add(imported)
                waiting.append(imported)
    return files


@lru_cache(maxsize=4096)
def _content(file: Path) -> bytes:
    return file.read_bytes()


@lru_cache(maxsize=4096)
def _imported(file: Path) -> tuple[Path, ...]:
    """Files of this package that a file imports; a name in `from … import name` may be a file or
    what a file defines.
    """
    return tuple(dict.fromkeys(_files_named(_content(file).decode())))


def _files_named(text: str) -> Iterator[Path]:
    for module, names, plain in _IMPORT.findall(text):
        path = _ROOT.joinpath(*(module or plain).split("."))
        for place in (path, *(path / name for name in _NAME.findall(names))):
            for file in (place.with_suffix(".py"), place / "__init__.py"):
                if file.is_file():
                    yield file


class _Locator(InTreeCacheLocator):
    """Where a loop is kept, and the stamp of what it is made of."""

    def get_cache_path(self) -> str:
        """A folder for each version of a file, in one that belongs to this user alone."""
        file = Path(self._py_file)
        versions = code_folder("loops", "NUMBA_CACHE_DIR") / "_".join(
            file.with_suffix("").relative_to(_ROOT).parts
        )
        folder = versions / self.get_source_stamp()[:24]
        if not folder.is_dir():
            folder.mkdir(parents=True, exist_ok=True)
            _forget_oldest(versions)
        # The time of a folder is that of its last use, by which the oldest goes.
        os.utime(folder)
        return str(folder)

    def get_source_stamp(self) -> str:
        """Changes when anything changes that the loop is made of."""
        return made_of(Path(self._py_file))


def _forget_oldest(versions: Path) -> None:
    """Remove what has not been used for longest; another process may do the same at the same
    time.
    """
    with suppress(FileNotFoundError):
        for folder in sorted(versions.iterdir(), key=lambda folder: -folder.stat().st_mtime)[
            _KEPT:
        ]:
            shutil.rmtree(folder, ignore_errors=True)


class _KeptResult(CompileResultCacheImpl):
    _locator_classes: ClassVar[list[type[object]]] = [_Locator]


class _KeptLoop(FunctionCache):
    _impl_class = _KeptResult
