"""A picture as a file to be sent: an interactive HTML page that needs nothing else, or a PNG image
by Matplotlib, for Plotly itself needs a whole browser for an image.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from residuum.identification.errors import BadInput
from residuum.library.optional_package import need
from residuum.library.picture import Bars, Curve, Panel, Picture
from residuum.library.plotly_figure import COLOURS, MOST_POINTS, figure
from residuum.library.whole_file import write_whole
from residuum.nearest_names import known_names

ENDINGS = (".png", ".html")
# Of an image, of a panel in it, and what each bar adds to that [inch].
_WIDTH, _HEIGHT, _PER_BAR = 9.0, 2.6, 0.28
# Dots an inch.
_DOTS = 120


def check_picture_file(path: Path) -> None:
    """Refuse, before the work is done, a picture that could not be written.

    Raises
    ------
    BadInput
        Another ending than `.png` or `.html`.
    MissingPackage
        Matplotlib, which draws images, is not installed.

    >>> check_picture_file(Path("a.pgn"))
    Traceback (most recent call last):
    residuum.identification.errors.BadInput: a.pgn: ending '.pgn' is no picture; did you mean '.png'? known are .png, .html
    """
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        raise BadInput(f"{path}: ending {ending!r} is no picture; {known_names(ending, ENDINGS)}")
    if ending == ".png":
        _need_matplotlib()


def write_picture(picture: Picture, path: Path, title: str) -> None:
    """Write the picture as a page (`.html`, about 5 MB: Plotly is inside) or an image (`.png`), by
    the ending of `path`.

    Raises
    ------
    BadInput, MissingPackage
        As `check_picture_file` says; a folder that does not exist.
    """
    check_picture_file(path)
    # By Matplotlib: for an image Plotly needs a whole browser.
    if path.suffix.lower() == ".png":
        write_whole(path, _png(picture))
        return
    drawn = figure(picture)
    drawn.update_layout(title={"text": escape(title)}, margin={"t": 90, "b": 50})
    # Plotly's script is inside: the page has to open where there is no network.
    page: str = drawn.to_html(full_html=True, include_plotlyjs=True)
    # Plotly gives its page no title; the text holds a user's names, hence the escape.
    write_whole(path, page.replace("<head>", f"<head><title>{escape(title)}</title>", 1))


def _png(picture: Picture) -> bytes:
    """The picture as a PNG file's content.

    Raises
    ------
    MissingPackage
        Matplotlib is not installed.
    """
    figure = _need_matplotlib().Figure(
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
            _curves(axes, panel, panel.content)
    content = BytesIO()
    figure.savefig(content, format="png")
    return content.getvalue()


def _need_matplotlib() -> Any:
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
    # Matplotlib counts upwards; the first bar belongs on top.
    axes.invert_yaxis()
    axes.set_xlabel(label)
    if bars.texts:
        axes.bar_label(drawn, list(bars.texts), fontsize=8, padding=2)


def _curves(axes: Any, panel: Panel, curves: Sequence[Curve]) -> None:
    for number, whole in enumerate(curves):
        curve = whole.reduced(MOST_POINTS)
        colour = COLOURS[number % len(COLOURS)]
        axes.plot(curve.x, curve.y, color=colour, linewidth=1.0, label=curve.name)
        if curve.low is not None and curve.high is not None:
            axes.fill_between(curve.x, curve.low, curve.high, color=colour, alpha=0.2, linewidth=0)
    axes.set(xlabel=panel.x_label, ylabel=panel.y_label, xscale=panel.x_scale)
    axes.legend(fontsize=8, loc="best")
