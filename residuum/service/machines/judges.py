"""Trained diagnosers at hand: one instance a diagnoser and baseline, loaded once and shared by all requests."""

from __future__ import annotations

import tempfile
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from residuum.diagnosis.diagnosers import DIAGNOSERS
from residuum.diagnosis.diagnosers.base import Diagnoser
from residuum.service.store import NotFound

_MOST_KEPT = 256

Baseline = Callable[[str], tuple[str, bytes]]
"""Gives (version tag, stored file) of a named baseline; NotFound when there is none."""


class Judges:
    """Diagnosers by name, settings and baseline.

    A baseline is a stored trained diagnoser (model of kind `baseline`). A new version of it is taken up by the next call.
    """

    def __init__(self, baseline: Baseline) -> None:
        self._baseline = baseline
        self._kept: dict[tuple[Any, ...], Diagnoser] = {}
        self._lock = threading.Lock()

    def untrained(self, diagnoser: str, settings: Mapping[str, Any] | None = None) -> Diagnoser:
        """A diagnoser without baseline, which judges by absolute indicators and fault lines; BadInput for a setting it lacks."""
        key = (diagnoser, repr(sorted((settings or {}).items())))
        return self._get(key, lambda: diagnoser_class(diagnoser)().with_settings(**(settings or {})))

    def trained(self, diagnoser: str, baseline: str) -> Diagnoser:
        """A diagnoser with the newest version of a stored baseline; BadInput when it is one of another diagnoser."""
        version, content = self._baseline(baseline)
        return self._get((diagnoser, baseline, version), lambda: _load(diagnoser_class(diagnoser), content))

    def _get(self, key: tuple[Any, ...], make: Callable[[], Diagnoser]) -> Diagnoser:
        with self._lock:
            if key in self._kept:
                return self._kept[key]
        judge = make()
        with self._lock:
            while len(self._kept) >= _MOST_KEPT:
                self._kept.pop(next(iter(self._kept)))
            return self._kept.setdefault(key, judge)


def diagnoser_class(name: str) -> type[Diagnoser]:
    """The class of this name; NotFound lists the names there are."""
    if name not in DIAGNOSERS:
        raise NotFound(f"diagnoser {name[:60]!r}: there is none of this name; known are {', '.join(DIAGNOSERS)}")
    return DIAGNOSERS[name]


def _load(kind: type[Diagnoser], content: bytes) -> Diagnoser:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "baseline"
        file.write_bytes(content)
        return kind.load(file)
