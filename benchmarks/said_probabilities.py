"""Do the probabilities that `explain` says come true? Each statement with what was hidden, as a table and as a picture.

A case makes up to three statements: that the effect missing is among the first candidate's group, that something without a name
is missing, that nothing is. An effect counts as named where its id is in the group, whatever else is equal to it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.reliability import ReliabilityLine, expected_calibration_error, reliability_table

TENTHS = tuple(np.linspace(0.0, 1.0, 11).tolist())
NAMED, UNKNOWN, NONE = "the first group", "something unknown", "nothing"
KINDS = (NAMED, UNKNOWN, NONE)
HEAD = "| said | statements | mean said | true | 95 % | agrees |\n|---|---|---|---|---|---|"


@dataclass(frozen=True)
class Statement:
    """What was said to be true, with which probability, and whether it was."""

    what: str
    said: float
    true: bool


def statements(hidden: Sequence[str], outcome: Mapping[str, Any]) -> list[Statement]:
    """Those of one case; `hidden` are the effects' ids, of which the catalogue does not know those that begin with `x-`."""
    known = [id for id in hidden if not id.startswith("x-")]
    made = [Statement(NAMED, outcome["probability"], bool(set(known) & set(outcome["group"])))] if outcome["first"] else []
    made.append(Statement(UNKNOWN, outcome["unknown"], len(known) < len(hidden)))
    made.append(Statement(NONE, outcome["none"], not hidden))
    return [Statement(s.what, min(max(s.said, 0.0), 1.0), s.true) for s in made]


def lines_of(made: Sequence[Statement]) -> list[ReliabilityLine]:
    """By tenths of what was said."""
    return reliability_table([s.said for s in made], [s.true for s in made], TENTHS)


def told(made: Sequence[Statement]) -> str:
    """Tables of each kind of statement and of all, with the mean that was said of names that were wrong."""
    text = ["\n### Said and true"]
    for what in (*KINDS, "all three"):
        of = [s for s in made if what in (s.what, "all three")]
        if of:
            text.append(f"\n{what[0].upper()}{what[1:]}:\n\n{HEAD}")
            text += [_row(line) for line in lines_of(of)]
            error = expected_calibration_error([s.said for s in of], [s.true for s in of], TENTHS)
            text.append(f"\nExpected calibration error {error:.3f}")
    wrong = [s.said for s in made if s.what == NAMED and not s.true]
    if wrong:
        text.append(f"\nMean probability of a first group that was wrong: {np.mean(wrong):.2f} of {len(wrong)}")
    return "\n".join(text)


def _row(line: ReliabilityLine) -> str:
    low, high = line.interval
    bins = f"{line.low:.1f}–{line.high:.1f} | {line.n} | {line.predicted:.3f} | {line.observed:.3f}"
    return f"| {bins} | {low:.3f}–{high:.3f} | {'yes' if line.agrees else 'no'} |"
