"""A picture as a Plotly figure."""

from __future__ import annotations

from typing import Any

import numpy as np

from residuum.library.optional_package import need
from residuum.library.picture import Bars, Curve, Panel, Picture

MOST_POINTS = 4000
"""Of a curve."""
COLOURS = ("#1f6f8b", "#d1495b", "#66a182", "#edae49", "#8d6a9f", "#5c6b73")
# Of a panel [px].
_HEIGHT = 260


def figure(picture: Picture) -> Any:
    """The picture as a `plotly.graph_objects.Figure`, to be changed at will.

    Raises
    ------
    MissingPackage
        Plotly is not installed.
    """
    graphs, subplots = need("plotly.graph_objects", "a figure"), need("plotly.subplots", "a figure")
    panels = picture.panels
    plot = subplots.make_subplots(
        rows=len(panels), cols=1, subplot_titles=[panel.title for panel in panels]
    )
    for row, panel in enumerate(panels, start=1):
        for trace in _traces(graphs, panel):
            plot.add_trace(trace, row=row, col=1)
        plot.update_xaxes(
            title_text=panel.x_label,
            # Bars stand over names, whose axis is neither linear nor logarithmic.
            type=panel.x_scale if _is_curves(panel) else None,
            row=row,
            col=1,
        )
        plot.update_yaxes(title_text=panel.y_label, row=row, col=1)
    plot.update_layout(
        template="plotly_white", height=_HEIGHT * len(panels) + 80, margin={"t": 60, "b": 50}
    )
    return plot


def _is_curves(panel: Panel) -> bool:
    return not isinstance(panel.content, Bars)


def _traces(graphs: Any, panel: Panel) -> list[Any]:
    if isinstance(panel.content, Bars):
        bars = panel.content
        return [
            graphs.Bar(
                x=list(bars.names),
                y=list(bars.values),
                text=list(bars.texts) or None,
                marker_color=COLOURS[0],
            )
        ]
    traces: list[Any] = []
    for number, curve in enumerate(panel.content):
        colour = COLOURS[number % len(COLOURS)]
        traces += _curve(graphs, curve.reduced(MOST_POINTS), colour)
    return traces


def _curve(graphs: Any, curve: Curve, colour: str) -> list[Any]:
    line = graphs.Scatter(
        x=curve.x, y=curve.y, name=curve.name, mode="lines", line={"color": colour}
    )
    if curve.low is None or curve.high is None:
        return [line]
    # A band is one outline: along its upper edge, and back along the lower one.
    x, y = np.concatenate([curve.x, curve.x[::-1]]), np.concatenate([curve.high, curve.low[::-1]])
    band = graphs.Scatter(
        x=x,
        y=y,
        fill="toself",
        fillcolor=colour,
        opacity=0.2,
        line={"width": 0},
        name=f"{curve.name}, 95 % band",
        hoverinfo="skip",
    )
    # What comes first is drawn first: the line lies on its band.
    return [band, line]
