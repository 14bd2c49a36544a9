"""Trained diagnosers at hand: one instance a diagnoser and baseline, loaded once and shared by all
requests.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from residuum.diagnosis.diagnosers import DIAGNOSERS
from residuum.diagnosis.diagnosers.base import Diagnoser
from residuum.nearest_names import known_names
from residuum.service.machines.judging.kept_diagnosers import KeptDiagnosers, diagnoser_of_content
from residuum.service.store import NotFound

Baseline = Callable[[str], tuple[str, bytes]]
"""Gives (version tag, stored file) of a named baseline; NotFound when there is none."""


class Judges:
    """Diagnosers by name, settings and baseline.

    A baseline is a stored trained diagnoser (model of kind `baseline`). A new version of it is
    taken up by the next call.
    """

    def __init__(self, baseline: Baseline) -> None:
        self._baseline = baseline
        self._kept = KeptDiagnosers()

    def untrained(self, diagnoser: str, settings: Mapping[str, Any] | None = None) -> Diagnoser:
        """A diagnoser without baseline, which judges by absolute indicators and fault lines;
        BadInput for a setting it lacks.
        """
        key = (diagnoser, repr(sorted((settings or {}).items())))
        return self._kept.get(
            key, lambda: diagnoser_class(diagnoser)().with_settings(**(settings or {}))
        )

    def trained(self, diagnoser: str, baseline: str) -> Diagnoser:
        """A diagnoser with the newest version of a stored baseline; BadInput when it is one of
        another diagnoser.
        """
        version, content = self._baseline(baseline)
        key = (diagnoser, baseline, version)
        return self._kept.get(
            key, lambda: diagnoser_of_content(diagnoser_class(diagnoser), content)
        )


def diagnoser_class(name: str) -> type[Diagnoser]:
    """The class of this name; NotFound lists the names there are."""
    if name not in DIAGNOSERS:
        raise NotFound(
            f"diagnoser {name[:60]!r}: there is none of this name; {known_names(name, DIAGNOSERS)}"
        )
    return DIAGNOSERS[name]
