"""Do the probabilities that `explain` says come true? Each statement with what was hidden, as a table and as a picture.

A case makes up to three statements: that the effect missing is among the first candidate's group, that something without a name
is missing, that nothing is. An effect counts as named where its id is in the group, whatever else is equal to it, and as nothing
where the record does not show it: where the model's own values take it up.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from residuum.diagnosis.learning.reliability import (
    TENTHS,
    ReliabilityLine,
    expected_calibration_error,
    reliability_table,
)

NAMED, UNKNOWN, NONE = "the first group", "something unknown", "nothing that the record shows"
SHOWS = 4.0
"""Twice the log-likelihood that the hidden effect has to gain over the refitted model to be more than chance."""
KINDS = (NAMED, UNKNOWN, NONE)
REAL = Path(__file__).parent / "results" / "real_names.csv"
HEAD = "| said | statements | mean said | true | 95 % | agrees |\n|---|---|---|---|---|---|"


@dataclass(frozen=True)
class Statement:
    """What was said to be true, with which probability, and whether it was; `claimed`: as the verdict."""

    what: str
    said: float
    true: bool
    claimed: bool = False


def statements(hidden: Sequence[str], outcome: Mapping[str, Any]) -> list[Statement]:
    """Those of one case; `hidden` are the effects' ids, of which the catalogue does not know those that begin with `x-`."""
    known = [id for id in hidden if not id.startswith("x-")]
    made, claimed = [], outcome["verdict"] == "missing-effect"
    if outcome["first"]:
        made.append(
            Statement(
                NAMED, outcome["probability"], bool(set(known) & set(outcome["group"])), claimed
            )
        )
    made.append(Statement(UNKNOWN, outcome["unknown"], len(known) < len(hidden)))
    made.append(Statement(NONE, outcome["none"], not hidden or _is_hidden_for_good(outcome)))
    return [replace(s, said=min(max(s.said, 0.0), 1.0)) for s in made]


def _is_hidden_for_good(outcome: Mapping[str, Any]) -> bool:
    gained = outcome["chi_square"]
    return gained is not None and gained < SHOWS


def real_names() -> list[Statement]:
    """What was said of real machines of which it is known what they lack, at the latest commit that told a probability."""
    with REAL.open(encoding="utf-8", newline="") as file:
        return [
            Statement(NAMED, float(row["said"]), row["true"] == "1") for row in csv.DictReader(file)
        ]


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
    claims = [s for s in made if s.claimed]
    wrong = [s.said for s in claims if not s.true]
    mean = f", with a mean probability of {np.mean(wrong):.2f}" if wrong else ""
    text.append(f"\nVerdicts that name an effect: {len(claims)}, wrong {len(wrong)}{mean}")
    real = real_names()
    text.append(
        f"\nReal machines, first group: {', '.join(f'{s.said:.2f} {_right(s)}' for s in real)}"
    )
    return "\n".join(text)


def _right(statement: Statement) -> str:
    return "right" if statement.true else "wrong"


def _row(line: ReliabilityLine) -> str:
    low, high = line.interval
    bins = f"{line.low:.1f}–{line.high:.1f} | {line.n} | {line.predicted:.3f} | {line.observed:.3f}"
    return f"| {bins} | {low:.3f}–{high:.3f} | {'yes' if line.agrees else 'no'} |"
