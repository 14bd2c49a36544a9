"""What a monitor says of one window."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from residuum.diagnosis.finding import Finding as Judged
from residuum.library.answers.finding import finding_text
from residuum.library.picture import Bars, Panel, Picture
from residuum.library.result import Result, Row


@dataclass(frozen=True, eq=False, repr=False)
class Finding(Result):
    """What a monitor says of one window.

    Attributes
    ----------
    found : Finding
        Verdict, fault class, indicators with units and thresholds, evidence, reason.

    Examples
    --------
    >>> import residuum as rs
    >>> healthy = rs.simulate("process-plant", seed=1)
    >>> window = rs.simulate("process-plant", seed=2)
    >>> finding = rs.monitor("robust-residual").fit(healthy).score(window)
    >>> finding.verdict
    'healthy'
    """

    found: Judged

    @property
    def verdict(self) -> str:
        """`healthy`, `faulty` or `not-assessable`."""
        return self.found.verdict.value

    @property
    def reason(self) -> str | None:
        """One sentence with the numbers."""
        return self.found.reason

    @property
    def fault_class(self) -> str | None:
        """The kind of fault, where the diagnoser tells kinds apart."""
        return self.found.fault_class

    def _answer(self) -> dict[str, Any]:
        return self.found.to_json()

    def __str__(self) -> str:
        return finding_text(self._answer())

    def _rows(self) -> Sequence[Row]:
        finding = self.found
        return [
            {
                "indicator": name,
                "value": value,
                "threshold": finding.thresholds.get(name),
                "unit": finding.units.get(name, ""),
            }
            for name, value in finding.indicators.items()
        ]

    def _picture(self) -> Picture:
        judged = {
            n: v / self.found.thresholds[n]
            for n, v in self.found.indicators.items()
            # An indicator without a threshold, or with one of 0, is no multiple of it.
            if self.found.thresholds.get(n)
        }
        texts = [f"{value:.2f} of its threshold" for value in judged.values()]
        bars = Bars(list(judged), list(judged.values()), texts)
        return Picture(
            [
                Panel(
                    f"{self.verdict}: indicators over their thresholds",
                    "",
                    "value / threshold",
                    bars,
                )
            ]
        )
