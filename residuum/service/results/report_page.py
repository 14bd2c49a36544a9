"""A month's report as one HTML page that opens offline: the page's own style, pictures as SVG, no
scripts.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from html import escape
from importlib.metadata import version
from importlib.resources import files

import numpy as np

from residuum.diagnosis.learning.reliability import ReliabilityLine
from residuum.library.comparison import Comparison
from residuum.library.explanation import Explanation
from residuum.library.picture import Curve, Panel, Picture
from residuum.library.record import Record
from residuum.library.result import Result
from residuum.library.svg import svg
from residuum.service.results.month_report import Followed, MonthReport
from residuum.service.results.said_and_found import SaidAndFound, said_and_found
from residuum.service.store import Confirmation

_STYLES = ("tokens", "base", "parts")
_OWN = (
    "main { max-width: 70rem; margin: 0 auto; padding: 1rem; } svg { display: block; margin: .5rem"
    " 0; } td.number, th.number { text-align: right; } .day { font-variant-numeric: tabular-nums; }"
    " @media print { section { break-inside: avoid; } }"
)
POLICY = "default-src 'none'; style-src 'unsafe-inline'; frame-ancestors 'none'"
"""What a browser may do with the page: nothing but show it."""
# Pictures one below the other; the names of others are told.
_MOST_CURVES = 24


def report_page(report: MonthReport, written_at: datetime | None = None) -> str:
    """The page's text; `written_at` is when (now)."""
    title = report.asset.title
    parts = [
        f"<h1>{escape(title)}: {escape(report.month)}</h1>",
        _summary(report),
        section("Faults", _faults(report)),
        section("Said and found", _said_and_found(report)),
        section("Alarms", _alarms(report)),
        section("Windows by day (UTC)", _days(report)),
        section("Windows that could not be judged", _reasons(report)),
        section("Parameters", _curves(report.parameters, report, "healthy band")),
        section("Indicators", _curves(report.indicators, report, "limit")),
        written_by(written_at),
    ]
    return whole_page(f"{title} {report.month}", parts)


def whole_page(title: str, parts: Sequence[str]) -> str:
    """A page of these parts that opens offline: the pages' own style, no scripts."""
    # in the page itself: it is sent by mail, and opens where nothing of ours is
    css = "\n".join(
        files("residuum.service.web").joinpath(f"assets/css/{name}.css").read_text("utf-8")
        for name in _STYLES
    )
    head = (
        '<meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>{escape(title)}</title><style>{css}\n{_OWN}</style>"
    )
    return (
        "<!doctype html>\n<html"
        f' lang="en"><head>{head}</head><body><main>{"".join(parts)}</main></body></html>\n'
    )


def written_by(written_at: datetime | None = None) -> str:
    """Who wrote a page, and when (now)."""
    return (
        f'<p class="muted small">Residuum {escape(version("residuum"))}, written'
        f" {_moment(written_at or datetime.now(UTC))}.</p>"
    )


def _summary(report: MonthReport) -> str:
    verdicts = report.verdicts
    total = sum(verdicts.values())
    if not total:
        return "<p>No window was judged in this month.</p>"
    shares = ", ".join(
        f"{n} {escape(name)} ({100 * n / total:.1f} %)" for name, n in sorted(verdicts.items())
    )
    # alarms that were raised, not those that stood: one may stand from the month before
    raised = sum(entry.event == "raise" for _, entries in report.alarms for entry in entries)
    return (
        f"<p>{total} windows were judged by {escape(report.asset.diagnoser or 'nobody')}: {shares}."
        f" Alarms raised: {raised}.</p>"
    )


def _faults(report: MonthReport) -> str:
    if not report.faults:
        return "<p>No window was judged faulty.</p>"
    ranked = sorted(report.faults.items(), key=lambda entry: -entry[1].windows)
    rows = [(name, str(f.windows), _moment(f.first), _moment(f.last), f.says) for name, f in ranked]
    return _table(("What", "Windows", "First", "Last", "The last one said"), rows, numbers=(1,))


def _said_and_found(report: MonthReport) -> str:
    """What was found of the month's findings, and how often what was said with which probability
    came true, at this machine in the month and at all machines until its end.
    """
    faulty = report.verdicts.get("faulty", 0)
    answered = sum(answer.verdict == "faulty" for answer in report.answered)
    parts = [
        f"<p>Of {faulty} faulty windows of this month {answered} were answered by who looked at the"
        " machine.</p>"
    ]
    rows = [_answered(answer) for answer in report.answered]
    head = ("Finding", "Said", "With", "Found", "Cause", "Part", "Order", "By", "Note")
    parts += [_table(head, rows, numbers=(2,))] if rows else []
    # a machine has few answers in a month: whether probabilities come true shows in the plant's
    of_machine, of_plant = said_and_found(report.answered), said_and_found(report.plant)
    if not of_plant.lines:
        return "".join([*parts, "<p>No finding that said a probability was answered yet.</p>"])
    series = {"this machine, this month": of_machine.lines, "the plant until then": of_plant.lines}
    drawn = {name: lines for name, lines in series.items() if lines}
    parts += [reliability_svg(drawn), _bins(of_plant)]
    return "".join(parts)


def _answered(answer: Confirmation) -> tuple[str, ...]:
    """A finding beside what somebody found at the machine, as a row."""
    return (
        _moment(answer.finding_at),
        answer.said,
        "" if answer.probability is None else f"{100 * answer.probability:.0f} %",
        answer.outcome,
        answer.cause or "",
        answer.part or "",
        answer.order or "",
        f"{answer.who}, {_moment(answer.found_at)}",
        answer.note or "",
    )


def _bins(counted: SaidAndFound) -> str:
    rows = [
        (
            f"{100 * line.low:.0f}–{100 * line.high:.0f} %",
            str(line.n),
            str(line.events),
            f"{100 * line.predicted:.1f} %",
            f"{100 * line.observed:.1f} %",
            f"{100 * line.interval[0]:.1f}–{100 * line.interval[1]:.1f} %",
            "yes" if line.agrees else "no",
        )
        for line in counted.lines
    ]
    head = ("Plant: said", "Answered", "Found so", "Mean said", "Share", "95 %", "Agrees")
    without = counted.without_probability
    more = f" {without} more were said without a probability." if without else ""
    return _table(head, rows, numbers=range(1, 6)) + (
        '<p class="muted small">Intervals after Clopper and Pearson, for findings that were'
        " answered independently of each other: several windows of one repair count too often."
        f" Only answered findings are counted.{more}</p>"
    )


def _alarms(report: MonthReport) -> str:
    rows = [
        (
            _moment(entry.at),
            alarm.kind,
            entry.event,
            str(entry.state),
            entry.by or "",
            entry.comment or "",
        )
        for alarm, entries in report.alarms
        for entry in entries
    ]
    return (
        _table(("When", "Alarm", "Event", "State then", "By", "Comment"), sorted(rows))
        if rows
        else "<p>None.</p>"
    )


def _days(report: MonthReport) -> str:
    names = sorted(report.verdicts)
    days = [
        (f"{report.month}-{number:02d}", day) for number, day in enumerate(report.days, 1) if day
    ]
    rows = [(date, *(str(day.get(name, 0)) for name in names)) for date, day in days]
    return (
        _table(("Day", *names), rows, numbers=range(1, len(names) + 1)) if rows else "<p>None.</p>"
    )


def _reasons(report: MonthReport) -> str:
    rows = [(reason, str(number)) for reason, number in report.reasons]
    return _table(("Why", "Windows"), rows, numbers=(1,)) if rows else "<p>None.</p>"


def _curves(followed: Mapping[str, Followed], report: MonthReport, limits: str) -> str:
    panels = [
        _panel(name, series, report, limits)
        for name, series in list(followed.items())[:_MOST_CURVES]
    ]
    if not panels:
        return "<p>None.</p>"
    left_out = list(followed)[_MOST_CURVES:]
    more = f"<p>Not drawn: {escape(', '.join(left_out))}.</p>" if left_out else ""
    return svg(Picture(panels), len(panels)) + more


def _panel(name: str, series: Followed, report: MonthReport, limits: str) -> Panel:
    # hours come before findings, and may lie behind them
    order = np.argsort(np.array([at.timestamp() for at in series.at]), kind="stable")
    day = np.array([(at - report.span.begin).total_seconds() / 86400 + 1 for at in series.at])[
        order
    ]
    value, low, high = (
        np.array(numbers)[order] for numbers in (series.value, series.low, series.high)
    )
    curves = [Curve(name, day, value)]
    edges = [edge for edge in (low, high) if np.isfinite(edge).any()]
    # named once, by the last: both edges are one band
    curves += [Curve(limits if edge is edges[-1] else "", day, edge) for edge in edges]
    return Panel(
        f"{name} [{series.unit}]" if series.unit else name, "day of the month", series.unit, curves
    )


def section(title: str, content: str) -> str:
    """A part of a page under its heading."""
    return f"<section><h2>{escape(title)}</h2>{content}</section>"


def _table(head: Sequence[str], rows: Iterable[Sequence[str]], numbers: Iterable[int] = ()) -> str:
    right = set(numbers)

    def cells(row: Sequence[str], tag: str) -> str:
        kinds = [' class="number"' if k in right else "" for k in range(len(row))]
        return "".join(
            f"<{tag}{kind}>{escape(text)}</{tag}>" for kind, text in zip(kinds, row, strict=True)
        )

    body = "".join(f"<tr>{cells(row, 'td')}</tr>" for row in rows)
    table = f"<table><thead><tr>{cells(head, 'th')}</tr></thead><tbody>{body}</tbody></table>"
    # who has no pointer scrolls by the keyboard, for which the part has to be reached
    name = escape(", ".join(head))
    return f'<div class="scroll" tabindex="0" role="group" aria-label="{name}">{table}</div>'


def _moment(at: datetime) -> str:
    return f"{at.astimezone(UTC):%Y-%m-%d %H:%M:%S}"


# Records, and a model held against them, as one HTML page that can be sent: it opens offline and
# has no scripts.


def analysis_page(title: str, records: Sequence[Record], answers: Sequence[Result]) -> str:
    """The page's text: each answer with its sentences and picture, then each record as it was
    read.
    """
    parts = [
        f"<h1>{escape(title)}</h1>",
        *(section(_question(answer), _answer(answer)) for answer in answers),
    ]
    parts += [section(record.source or "record", _record(record)) for record in records]
    return whole_page(title, [*parts, written_by()])


def _question(answer: Result) -> str:
    """What an answer answers, as its heading."""
    if isinstance(answer, Explanation):
        return "What the model lacks"
    return (
        "The model beside the records" if isinstance(answer, Comparison) else type(answer).__name__
    )


def _answer(answer: Result) -> str:
    picture = answer.picture()
    return f"<pre>{escape(str(answer))}</pre>{svg(picture, len(picture.panels))}"


def _record(record: Record) -> str:
    picture = record.picture()
    notes = "".join(f"<p>{escape(note)}</p>" for note in record.notes)
    return f"<p>{escape(str(record))}</p>{notes}{svg(picture, len(picture.panels))}"


# A reliability diagram as a small SVG: what came true over what was said, with 95 % intervals; both
# agree on the diagonal.

SIDE, LEFT, TOP, BELOW = 320, 56, 12, 96
"""[px] Of the square, and what stands around it: numbers left, names of the series below."""
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
    parts = [_axes(), *(_diamond(probability, true) for probability, true in single)]
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
    box = f'viewBox="0 0 {width} {height}" width="{width}" height="{height}"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {box}'
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
        f'<text transform="translate(16 {_y(0.5):g}) rotate(-90)" text-anchor="middle">'
        "share that was true</text>"
    )
    return "\n".join(text)


def _point(line: ReliabilityLine, colour: str, aside: float) -> str:
    x, (low, high) = _x(line.predicted) + aside, line.interval
    bar = f'<path d="M{x:.1f} {_y(low):.1f}V{_y(high):.1f}" stroke="{colour}" stroke-width="1.5"/>'
    circle = f'<circle cx="{x:.1f}" cy="{_y(line.observed):.1f}" r="4" fill="{colour}">'
    title = f"said {line.predicted:.2f}, true {line.observed:.2f} of {line.n}"
    return f"{bar}{circle}<title>{title}</title></circle>"


def _diamond(probability: float, true: bool) -> str:
    return _diamond_at(_x(probability), _y(1.0 if true else 0.0))


def _diamond_at(x: float, y: float) -> str:
    path = f"M{x - 5:.1f} {y:.1f}l5 -5l5 5l-5 5z"
    return f'<path d="{path}" fill="none" stroke="#333" stroke-width="1.5"/>'
