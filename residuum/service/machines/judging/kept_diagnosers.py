"""Trained diagnosers at hand: read from what is stored once, and kept for the next window."""

from __future__ import annotations

import tempfile
import threading
from collections.abc import Callable, Hashable
from pathlib import Path

from residuum.diagnosis.diagnosers import DIAGNOSERS
from residuum.diagnosis.diagnosers.base import Diagnoser

_MOST_KEPT = 256


class KeptDiagnosers:
    """One instance a key, shared by all threads; the oldest goes where there are too many."""

    def __init__(self) -> None:
        self._kept: dict[Hashable, Diagnoser] = {}
        self._lock = threading.Lock()

    def get(self, key: Hashable, make: Callable[[], Diagnoser]) -> Diagnoser:
        """The one that is kept under this key, or else the one that is made now."""
        with self._lock:
            if key in self._kept:
                return self._kept[key]
        judge = make()
        with self._lock:
            while len(self._kept) >= _MOST_KEPT:
                self._kept.pop(next(iter(self._kept)))
            return self._kept.setdefault(key, judge)


IN_THIS_PROCESS = KeptDiagnosers()
"""Those of a worker process, which is sent names of files and of stored baselines, never
diagnosers.
"""


def diagnoser_of_file(diagnoser: str, file: str | None) -> Diagnoser:
    """The diagnoser that a file holds, anew where the file changed; without a file the untrained
    one.
    """
    kind = DIAGNOSERS[diagnoser]
    if not file:
        return IN_THIS_PROCESS.get(diagnoser, kind)
    changed = Path(file).stat().st_mtime_ns
    return IN_THIS_PROCESS.get((diagnoser, file, changed), lambda: kind.load(Path(file)))


def diagnoser_of_content(kind: type[Diagnoser], content: bytes) -> Diagnoser:
    """The trained diagnoser that a stored baseline holds."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "baseline"
        file.write_bytes(content)
        return kind.load(file)


def content_of(trained: Diagnoser) -> bytes:
    """A trained diagnoser as it is stored."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "baseline"
        trained.save(file)
        return file.read_bytes()
