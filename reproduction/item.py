"""One figure or table of the source beside ours."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import plotly.graph_objects as go


@dataclass(frozen=True)
class Item:
    """What the source shows, what ours shows, and one line of agreement or difference.

    `by_construction` marks what could not have come out otherwise (a design's own constraint): it is shown, and no agreement.
    `rows` is a table whose first row is its head; `figures` are drawn below it.
    """

    where: str
    title: str
    source: str
    says: str
    agrees: bool
    rows: Sequence[Sequence[str]] = ()
    figures: Sequence[go.Figure] = field(default=())
    by_construction: bool = False

    @property
    def word(self) -> str:
        """What is said of it in one word or three."""
        if not self.agrees:
            return "differs"
        return "holds by construction" if self.by_construction else "agrees"
