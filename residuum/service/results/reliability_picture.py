"""A reliability diagram as a small SVG: what came true over what was said, with 95 % intervals; both
agree on the diagonal.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

from residuum.diagnosis.learning.reliability import ReliabilityLine

SIDE, LEFT, TOP, BELOW = 320, 56, 12, 96
COLOURS = ("#00695c", "#c05600", "#5b4b8a")
APART = 5
"""[px] Between the series, so that intervals of one bin do not hide each other."""


def reliability_svg(
    series: Mapping[str, Sequence[ReliabilityLine]],
    single: Sequence[tuple[float, bool]] = (),
    single_name: str = "single statements",
) -> str:
    """The picture of several series of bins, by name, and of `single` statements, (said, whether
    true).
    """
    parts = [_axes(), *(_diamond(said, true) for said, true in single)]
    for k, (name, lines) in enumerate(series.items()):
        colour, aside = COLOURS[k % len(COLOURS)], APART * (k - (len(series) - 1) / 2)
        parts += [_point(line, colour, aside) for line in lines]
        y = TOP + SIDE + 58 + 16 * k
        count = sum(line.n for line in lines)
        parts.append(f'<circle cx="{LEFT + 6}" cy="{y - 4}" r="4" fill="{colour}"/>')
        parts.append(f'<text x="{LEFT + 18}" y="{y}">{escape(name)} ({count})</text>')
    if single:
        y = TOP + SIDE + 58 + 16 * len(series)
        parts += [
            _diamond_at(LEFT + 6, y - 4),
            f'<text x="{LEFT + 18}" y="{y}">{escape(single_name)} ({len(single)})</text>',
        ]
    width, height = LEFT + SIDE + 20, TOP + SIDE + BELOW + 20
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}"'
    style = 'font-family="sans-serif" font-size="12" fill="#333"'
    back = f'<rect width="{width}" height="{height}" fill="#fff"/>'
    return f"{head} {style}>\n{back}\n" + "\n".join(parts) + "\n</svg>\n"


def _x(p: float) -> float:
    return LEFT + SIDE * p


def _y(p: float) -> float:
    return TOP + SIDE * (1.0 - p)


def _axes() -> str:
    text = [f'<path d="M{_x(0):g} {_y(1):g}V{_y(0):g}H{_x(1):g}" fill="none" stroke="#333"/>']
    text.append(
        f'<path d="M{_x(0):g} {_y(0):g}L{_x(1):g} {_y(1):g}" stroke="#999" stroke-dasharray="4 4"/>'
    )
    for tenth in range(0, 11, 2):
        p = tenth / 10
        text.append(f'<text x="{_x(p):g}" y="{_y(0) + 16:g}" text-anchor="middle">{p:g}</text>')
        text.append(f'<text x="{LEFT - 8}" y="{_y(p) + 4:g}" text-anchor="end">{p:g}</text>')
    text.append(
        f'<text x="{_x(0.5):g}" y="{_y(0) + 34:g}" text-anchor="middle">probability said</text>'
    )
    text.append(
        f'<text transform="translate(16 {_y(0.5):g}) rotate(-90)" text-anchor="middle">share that was true</text>'
    )
    return "\n".join(text)


def _point(line: ReliabilityLine, colour: str, aside: float) -> str:
    x, (low, high) = _x(line.predicted) + aside, line.interval
    bar = f'<path d="M{x:.1f} {_y(low):.1f}V{_y(high):.1f}" stroke="{colour}" stroke-width="1.5"/>'
    told = f"said {line.predicted:.2f}, true {line.observed:.2f} of {line.n}"
    return f'{bar}<circle cx="{x:.1f}" cy="{_y(line.observed):.1f}" r="4" fill="{colour}"><title>{told}</title></circle>'


def _diamond(said: float, true: bool) -> str:
    return _diamond_at(_x(said), _y(1.0 if true else 0.0))


def _diamond_at(x: float, y: float) -> str:
    return f'<path d="M{x - 5:.1f} {y:.1f}l5 -5l5 5l-5 5z" fill="none" stroke="#333" stroke-width="1.5"/>'
