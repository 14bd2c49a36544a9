"""One figure or table of the source beside ours."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import plotly.graph_objects as go


@dataclass(frozen=True)
class Item:
    """What the source shows, what ours shows, and one line of agreement or difference.

    `rows` is a table whose first row is its head; `figures` are drawn below it.
    """

    where: str
    title: str
    source: str
    says: str
    agrees: bool
    rows: Sequence[Sequence[str]] = ()
    figures: Sequence[go.Figure] = field(default=())
