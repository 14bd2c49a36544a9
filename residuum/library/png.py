"""A picture as a PNG image, by Matplotlib: Plotly itself needs a whole browser for an image."""

from __future__ import annotations

from io import BytesIO
from typing import Any

import numpy as np

from residuum.library.optional_package import need
from residuum.library.picture import Bars, Curve, Panel, Picture
from residuum.library.plotly_figure import COLOURS, MOST_POINTS

_WIDTH, _HEIGHT, _PER_BAR = 9.0, 2.6, 0.28  # inches
_DOTS = 120
"""An inch."""


def png(picture: Picture) -> bytes:
    """The picture as a PNG file's content.

    Raises
    ------
    MissingPackage
        Matplotlib is not installed.
    """
    figure = need_matplotlib().Figure(
        figsize=(_WIDTH, sum(map(_height, picture.panels))), dpi=_DOTS, layout="constrained"
    )
    rows = figure.subplots(
        len(picture.panels),
        1,
        squeeze=False,
        height_ratios=[_height(panel) for panel in picture.panels],
    )
    for axes, panel in zip(rows[:, 0], picture.panels, strict=True):
        axes.set_title(panel.title, loc="left", fontsize=10)
        if isinstance(panel.content, Bars):
            _bars(axes, panel.content, panel.y_label)
        else:
            _curves(axes, panel)
    content = BytesIO()
    figure.savefig(content, format="png")
    return content.getvalue()


def need_matplotlib() -> Any:
    """Matplotlib's figures, without a window or a state of their own; MissingPackage says how to
    get them.
    """
    return need("matplotlib.figure", "a PNG image", extra="plots")


def _height(panel: Panel) -> float:
    return (
        max(_HEIGHT, 1.0 + _PER_BAR * len(panel.content.values))
        if isinstance(panel.content, Bars)
        else _HEIGHT
    )


def _bars(axes: Any, bars: Bars, label: str) -> None:
    places = np.arange(len(bars.values))
    drawn = axes.barh(places, list(bars.values), color=COLOURS[0])
    axes.set_yticks(places, list(bars.names), fontsize=8)
    axes.invert_yaxis()
    axes.set_xlabel(label)
    if bars.texts:
        axes.bar_label(drawn, list(bars.texts), fontsize=8, padding=2)


def _curves(axes: Any, panel: Panel) -> None:
    curves: list[Curve] = [curve.reduced(MOST_POINTS) for curve in panel.content]  # type: ignore[union-attr]  # Bars go elsewhere
    for number, curve in enumerate(curves):
        colour = COLOURS[number % len(COLOURS)]
        axes.plot(curve.x, curve.y, color=colour, linewidth=1.0, label=curve.name)
        if curve.low is not None and curve.high is not None:
            axes.fill_between(curve.x, curve.low, curve.high, color=colour, alpha=0.2, linewidth=0)
    axes.set(xlabel=panel.x_label, ylabel=panel.y_label, xscale=panel.x_scale)
    axes.legend(fontsize=8, loc="best")
