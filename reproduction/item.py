"""One figure or table of the source beside ours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import plotly.graph_objects as go

from reproduction.check import Check


@dataclass(frozen=True)
class Item:
    """What the source shows, the checks that hold ours against it, and what a difference comes from.

    Parameters
    ----------
    where : str
        The figure, table or section.
    title, source : str
        What it is, and what the source says of it.
    checks : sequence of Check
        What was measured. Without any the item is a drawing: there is nothing to measure.
    reason : str
        Of a difference: the cause that was tried, with what the trial gave.
    rows, figures
        A table whose first row is its head; figures drawn below it.
    """

    where: str
    title: str
    source: str
    checks: Sequence[Check] = ()
    reason: str = ""
    rows: Sequence[Sequence[str]] = ()
    figures: Sequence[go.Figure] = field(default=())

    @property
    def counted(self) -> list[Check]:
        """The checks that could have failed; what holds by construction is no agreement."""
        return [check for check in self.checks if not check.by_construction]

    @property
    def agrees(self) -> bool:
        """Whether every check holds and at least one could have failed."""
        return bool(self.counted) and all(check.holds for check in self.checks)

    @property
    def differs(self) -> bool:
        """Whether a check does not hold."""
        return not all(check.holds for check in self.checks)

    @property
    def word(self) -> str:
        """What is said of it in one word or three."""
        if not self.checks:
            return "drawing"
        if self.differs:
            return "differs"
        return "agrees" if self.counted else "holds by construction"

    @property
    def says(self) -> str:
        """What was measured, in a sentence a check, those that do not hold first."""
        ordered = sorted(self.checks, key=lambda check: check.holds)
        return "; ".join(check.sentence for check in ordered)
