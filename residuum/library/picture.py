"""A picture as a value: curves and bars, drawn by Plotly for a person who works with it, by SVG for
a notebook's output.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class Curve:
    """y over x, shape (n,) each; NaN leaves a gap. `low` and `high`, shape (n,), are the edges of
    its band.
    """

    name: str
    x: Array
    y: Array
    low: Array | None = None
    high: Array | None = None

    def reduced(self, points: int) -> Curve:
        """The curve with some `points` at most: the smallest and largest value of each stretch are
        kept, in their order.

        A curve with a band keeps every k-th point.

        >>> x = np.arange(1000.0)
        >>> curve = Curve("y", x, np.where(x == 777, 9.0, 0.0)).reduced(100)
        >>> len(curve.x) <= 100, float(curve.y.max())
        (True, 9.0)
        """
        n = len(self.x)
        if n <= points:
            return self
        if self.low is not None and self.high is not None:
            # Line and band have one x, so that the extremes of one are not those of the other.
            step = slice(None, None, -(-n // points))
            return Curve(self.name, self.x[step], self.y[step], self.low[step], self.high[step])
        # Two points a stretch: a peak of one sample stays, which picking every k-th point may lose.
        extremes = _extremes(np.asarray(self.y, dtype=float), max(1, points // 2))
        return Curve(self.name, self.x[extremes], self.y[extremes])


@dataclass(frozen=True, eq=False)
class Bars:
    """Named values side by side; `texts` stand beside them; `whole` is what the longest bar would
    stand for.
    """

    names: Sequence[str]
    values: Sequence[float]
    texts: Sequence[str] = ()
    whole: float | None = None


@dataclass(frozen=True, eq=False)
class Panel:
    """One pair of axes: curves, or bars."""

    title: str
    x_label: str
    y_label: str
    content: Sequence[Curve] | Bars
    x_scale: Literal["linear", "log"] = "linear"


@dataclass(frozen=True, eq=False)
class Picture:
    """Panels, one below the other."""

    panels: Sequence[Panel]


def _extremes(y: Array, stretches: int) -> npt.NDArray[np.intp]:
    """Indices of the smallest and largest value of each of so many stretches; a stretch of NaN
    alone keeps its first.
    """
    edges = np.linspace(0, len(y), stretches + 1).astype(np.intp)
    indices: list[int] = []
    for begin, end in pairwise(edges.tolist()):
        part = y[begin:end]
        if np.isnan(part).all():
            indices.append(begin)
            continue
        indices += sorted({int(begin + np.nanargmin(part)), int(begin + np.nanargmax(part))})
    return np.array(indices, dtype=np.intp)


def axis(name: str, unit: str) -> str:
    """`name [unit]`, or the name alone.

    >>> axis("speed", "rad/s"), axis("ratio", "")
    ('speed [rad/s]', 'ratio')
    """
    return f"{name} [{unit}]" if unit else name
