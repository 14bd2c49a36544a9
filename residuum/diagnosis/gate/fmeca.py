"""Failure modes, effects and criticality: the criticality matrix, and which diagnoser covers which
mode.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from residuum.identification.errors import BadInput
from residuum.identification.yaml_text import read_yaml

MACHINE = "gate-actuator"
"""Whose failure modes the file beside this holds."""
PROBABILITIES = {
    "A": "probable",
    "B": "remote",
    "C": "extremely remote",
    "D": "extremely improbable",
}
SEVERITIES = {"I": "catastrophic", "II": "hazardous", "III": "major", "IV": "minor"}
GATE = Path(__file__).parent / "gate_fmeca.yaml"
_FIELDS = ("id", "component", "failure", "cause", "effect", "probability", "severity")


class Risk(StrEnum):
    """Colour of a cell of the criticality matrix."""

    ACCEPTABLE = "green"
    TOLERABLE = "yellow"
    REDESIGN = "red"


@dataclass(frozen=True)
class FailureMode:
    """One way to fail.

    `probability` A–D, `severity` I–IV; `covered_by` maps the name of a diagnoser to the class that
    it reports, empty when nothing covers the mode.
    """

    id: str
    component: str
    failure: str
    cause: str
    effect: str
    probability: str
    severity: str
    covered_by: Mapping[str, str]

    def __post_init__(self) -> None:
        if self.probability not in PROBABILITIES:
            raise BadInput(
                f"failure mode {self.id!r}: probability {self.probability!r} must be one of"
                f" {', '.join(PROBABILITIES)}"
            )
        if self.severity not in SEVERITIES:
            raise BadInput(
                f"failure mode {self.id!r}: severity {self.severity!r} must be one of"
                f" {', '.join(SEVERITIES)}"
            )

    @property
    def risk(self) -> Risk:
        """Colour of its cell."""
        return risk(self.probability, self.severity)


def risk(probability: str, severity: str) -> Risk:
    """Colour of a cell: rank of probability (D 0 … A 3) plus rank of severity (IV 0 … I 3); ≥ 3
    red, 2 yellow, else green.

    The figure's colours are not printed in words; this rule gives what the text says of its six
    modes: short circuit (B-I), broken shaft (C-I) and corrupted wheel (B-III) are too critical or
    too probable and call for a redesign, broken gear (C-III) and broken teeth (D-IV) do not.

    >>> cells = [("B", "I"), ("C", "I"), ("B", "III"), ("C", "III"), ("D", "IV")]
    >>> [str(risk(*cell)) for cell in cells]
    ['red', 'red', 'red', 'yellow', 'green']
    """
    rank = list(reversed(PROBABILITIES)).index(probability) + list(reversed(SEVERITIES)).index(
        severity
    )
    return Risk.REDESIGN if rank >= 3 else Risk.TOLERABLE if rank == 2 else Risk.ACCEPTABLE


def load_fmeca(path: str | Path = GATE) -> list[FailureMode]:
    """The failure modes of a YAML file (default: those of the gate actuator).

    Raises BadInput with file, mode and rule when it is not one.
    """
    content = read_yaml(Path(path), BadInput)
    modes = content.get("modes") if isinstance(content, dict) else None
    if not isinstance(modes, list) or not modes:
        raise BadInput(f"{path}: has no list `modes`")
    loaded = [_mode(entry, f"{path}, mode {number}") for number, entry in enumerate(modes, start=1)]
    if len({mode.id for mode in loaded}) != len(loaded):
        raise BadInput(f"{path}: two modes share an id; each needs its own")
    return loaded


def criticality_matrix(modes: Sequence[FailureMode]) -> dict[tuple[str, str], list[FailureMode]]:
    """Modes in each of the 16 cells (probability, severity), empty cells included (the source's
    Figure 78).
    """
    cells: dict[tuple[str, str], list[FailureMode]] = {
        (p, s): [] for p in PROBABILITIES for s in SEVERITIES
    }
    for mode in modes:
        cells[mode.probability, mode.severity].append(mode)
    return cells


def coverage(
    modes: Sequence[FailureMode], diagnosers: Mapping[str, Sequence[str]]
) -> dict[str, list[tuple[str, str]]]:
    """Which (diagnoser, class) covers each mode, by id; an empty list is a mode that nothing
    covers.

    `diagnosers` maps the names there are to their classes. Raises BadInput when a mode names a
    diagnoser or class there is not: such a link would promise what nobody keeps.
    """
    links: dict[str, list[tuple[str, str]]] = {}
    for mode in modes:
        for name, fault_class in mode.covered_by.items():
            if fault_class not in diagnosers.get(name, ()):
                raise BadInput(
                    f"failure mode {mode.id!r}: there is no diagnoser {name!r} with class"
                    f" {fault_class!r}"
                )
        links[mode.id] = list(mode.covered_by.items())
    return links


def _mode(entry: Any, where: str) -> FailureMode:
    if not isinstance(entry, dict):
        raise BadInput(f"{where}: must be a mapping")
    if missing := [name for name in _FIELDS if not isinstance(entry.get(name), str)]:
        raise BadInput(f"{where}: {missing[0]!r} is missing or not a text")
    covered = entry.get("covered_by", {})
    if not isinstance(covered, dict) or not all(
        isinstance(text, str) for pair in covered.items() for text in pair
    ):
        raise BadInput(f"{where}: covered_by must map a diagnoser to its class")
    return FailureMode(**{name: entry[name] for name in _FIELDS}, covered_by=covered)
