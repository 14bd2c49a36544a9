"""A picture as an SVG text: small, without scripts, shown by every notebook viewer."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from residuum.library.picture import Array, Bars, Curve, Panel, Picture

# Of a panel [px].
_WIDTH, _HEIGHT = 560, 150
# Margins of the axes [px], for numbers and names.
_LEFT, _RIGHT, _TOP, _BOTTOM = 62, 12, 20, 30
# Of a curve: more than one a pixel cannot be seen.
_POINTS = 600
# Those of the Plotly figures: a curve has one colour in both.
_COLOURS = ("#1f6f8b", "#d1495b", "#66a182", "#edae49", "#8d6a9f", "#5c6b73")


def svg(picture: Picture, panels: int = 2) -> str:
    """The first panels of the picture as one `<svg>` element."""
    shown = picture.panels[:panels]
    parts = [
        f'<g transform="translate(0 {_HEIGHT * row})">{_panel(panel)}</g>'
        for row, panel in enumerate(shown)
    ]
    height = _HEIGHT * len(shown)
    style = "max-width:100%;background:#fff"
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{_WIDTH}" height="{height}" viewBox="0 0'
        f' {_WIDTH} {height}" style="{style}" font-family="sans-serif" font-size="11"'
        f' fill="#222">{"".join(parts)}</svg>'
    )


def _panel(panel: Panel) -> str:
    drawn = (
        _bars(panel.content)
        if isinstance(panel.content, Bars)
        else _curves(panel.content, panel.x_scale == "log")
    )
    frame = (
        f'<rect x="{_LEFT}" y="{_TOP}" width="{_WIDTH - _LEFT - _RIGHT}"'
        f' height="{_HEIGHT - _TOP - _BOTTOM}" fill="none" stroke="#ccc"/>'
    )
    labels = _text(_LEFT, _TOP - 6, panel.title, weight="bold") + _text(
        _WIDTH - _RIGHT, _HEIGHT - 4, panel.x_label, anchor="end"
    )
    return frame + drawn + labels


def _curves(curves: Sequence[Curve], logarithmic: bool) -> str:
    reduced = [curve.reduced(_POINTS) for curve in curves]
    across = [
        np.log10(curve.x) if logarithmic else np.asarray(curve.x, dtype=float) for curve in reduced
    ]
    x_span = _span(across)
    y_span = _span([edge for c in reduced for edge in (c.y, c.low, c.high) if edge is not None])
    parts = []
    for number, (curve, x) in enumerate(zip(reduced, across, strict=True)):
        colour = _COLOURS[number % len(_COLOURS)]
        places = _scaled(x, x_span, _LEFT, _WIDTH - _RIGHT)
        if curve.low is not None and curve.high is not None:
            # A band is one outline: along its upper edge, and back along the lower one.
            edges = [_heights(edge, y_span) for edge in (curve.high, curve.low)]
            outline = _points(np.r_[places, places[::-1]], np.r_[edges[0], edges[1][::-1]])
            parts.append(f'<polygon points="{outline}" fill="{colour}" opacity=".2"/>')
        parts.append(
            f'<path d="{_path(places, _heights(curve.y, y_span))}" fill="none" stroke="{colour}"'
            ' stroke-width="1.2"/>'
        )
        parts.append(
            _text(
                _WIDTH - _RIGHT - 6,
                _TOP + 12 + 12 * number,
                curve.name,
                anchor="end",
                colour=colour,
            )
        )
    return "".join(parts) + _ticks(x_span, y_span, logarithmic)


def _bars(bars: Bars) -> str:
    if not bars.values:
        return ""
    # Bars that are all zero have no longest one to be drawn against.
    top = max([*(abs(value) for value in bars.values if np.isfinite(value)), bars.whole or 1e-300])
    step = (_HEIGHT - _TOP - _BOTTOM) / len(bars.values)
    parts = []
    for number, (name, value) in enumerate(zip(bars.names, bars.values, strict=True)):
        y = _TOP + number * step
        length = (_WIDTH - _LEFT - _RIGHT) * (abs(value) / top if np.isfinite(value) else 0.0)
        text = f"{name}: {bars.texts[number] if bars.texts else f'{value:.3g}'}"
        parts.append(
            f'<rect x="{_LEFT}" y="{y + 1:.1f}" width="{length:.1f}"'
            f' height="{max(step - 2, 1):.1f}" fill="{_COLOURS[0]}" opacity=".35"/>'
        )
        parts.append(_text(_LEFT + 6, y + step / 2 + 4, text))
    return "".join(parts)


def _ticks(x_span: tuple[float, float], y_span: tuple[float, float], logarithmic: bool) -> str:
    ends = [10**value if logarithmic else value for value in x_span]
    low, high = (f"{value:.4g}" for value in y_span)
    return (
        _text(_LEFT, _HEIGHT - _BOTTOM + 12, f"{ends[0]:.4g}")
        + _text(_WIDTH - _RIGHT, _HEIGHT - _BOTTOM + 12, f"{ends[1]:.4g}", anchor="end")
        + _text(_LEFT - 4, _HEIGHT - _BOTTOM, low, anchor="end")
        + _text(_LEFT - 4, _TOP + 9, high, anchor="end")
    )


def _span(arrays: Sequence[Array]) -> tuple[float, float]:
    finite = (
        np.concatenate([np.asarray(a, dtype=float)[np.isfinite(a)] for a in arrays])
        if arrays
        else np.zeros(0)
    )
    if not finite.size:
        return 0.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    # A constant has a span, too, and lies in the middle of it.
    return (low, high) if high > low else (low - 0.5, high + 0.5)


def _scaled(values: Array, span: tuple[float, float], begin: float, end: float) -> Array:
    return np.asarray(
        begin + (end - begin) * (np.asarray(values, dtype=float) - span[0]) / (span[1] - span[0])
    )


def _heights(values: Array, span: tuple[float, float]) -> Array:
    return _scaled(values, span, _HEIGHT - _BOTTOM, _TOP)


def _path(x: Array, y: Array) -> str:
    """Straight lines through the points; a gap where one is not there."""
    finite = np.isfinite(x) & np.isfinite(y)
    parts, pen_up = [], True
    for a, b, known in zip(x, y, finite, strict=True):
        if known:
            parts.append(f"{'M' if pen_up else 'L'}{a:.1f} {b:.1f}")
        pen_up = not known
    return "".join(parts)


def _points(x: Array, y: Array) -> str:
    return " ".join(
        f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True) if np.isfinite(a) and np.isfinite(b)
    )


def _text(
    x: float,
    y: float,
    text: str,
    *,
    anchor: str = "start",
    weight: str = "normal",
    colour: str = "#222",
) -> str:
    return (
        # A channel's name comes from a file; unescaped it would be taken for elements of the page.
        f'<text x="{x:.0f}" y="{y:.0f}" text-anchor="{anchor}" font-weight="{weight}"'
        f' fill="{colour}">{escape(text)}</text>'
    )
