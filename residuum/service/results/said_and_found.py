"""What findings said beside what was found at the machines: counts, and shares of what came true by
the probability that was said.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from residuum.diagnosis.learning.reliability import (
    TENTHS,
    ReliabilityLine,
    calibration_error,
    reliability_table,
)
from residuum.service.store import Confirmation, Outcome


@dataclass(frozen=True)
class SaidAndFound:
    """Counts of answered findings.

    `lines` are tenths of said probabilities with the share found so and its 95 % Clopper–Pearson
    interval, which takes the findings as answered independently of each other.
    `calibration_error` is Σ n |said − share| / Σ n over them, None without any.
    """

    answered: int
    without_probability: int
    outcomes: Mapping[str, int]
    lines: Sequence[ReliabilityLine]
    calibration_error: float | None

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        bins = [
            {
                "low": line.low,
                "high": line.high,
                "n": line.n,
                "found": line.events,
                "said": line.predicted,
                "share": line.observed,
                "low_95": line.interval[0],
                "high_95": line.interval[1],
                "agrees": line.agrees,
            }
            for line in self.lines
        ]
        return {
            "answered": self.answered,
            "without_probability": self.without_probability,
            "outcomes": dict(self.outcomes),
            "bins": bins,
            "calibration_error": self.calibration_error,
        }


def said_and_found(confirmations: Sequence[Confirmation]) -> SaidAndFound:
    """Counts of confirmations, one a finding. Found so is what was confirmed: what was corrected
    was something else.
    """
    # what no probability was said of is counted, and says nothing of how probabilities come true
    pairs = [
        (answer.probability, answer.outcome == Outcome.CONFIRMED)
        for answer in confirmations
        if answer.probability is not None
    ]
    probabilities, true = [p for p, _ in pairs], [confirmed for _, confirmed in pairs]
    lines = reliability_table(probabilities, true, TENTHS) if pairs else []
    return SaidAndFound(
        answered=len(confirmations),
        without_probability=len(confirmations) - len(pairs),
        # every answer counts here, also without a probability
        outcomes=Counter(answer.outcome for answer in confirmations),
        lines=lines,
        calibration_error=calibration_error(lines) if lines else None,
    )
