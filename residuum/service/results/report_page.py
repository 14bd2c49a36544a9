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

from residuum.library.comparison import Comparison
from residuum.library.explanation import Explanation
from residuum.library.picture import Curve, Panel, Picture
from residuum.library.record import Record
from residuum.library.result import Result
from residuum.library.svg import svg
from residuum.service.results.month_report import Followed, MonthReport
from residuum.service.results.reliability_picture import reliability_svg
from residuum.service.results.said_and_found import SaidAndFound, said_and_found

_STYLES = ("tokens", "base", "parts")
_OWN = (
    "main { max-width: 70rem; margin: 0 auto; padding: 1rem; } svg { display: block; margin: .5rem"
    " 0; } td.number, th.number { text-align: right; } .day { font-variant-numeric: tabular-nums; }"
    " @media print { section { break-inside: avoid; } }"
)
POLICY = "default-src 'none'; style-src 'unsafe-inline'; frame-ancestors 'none'"
"""What a browser may do with the page: nothing but show it."""
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
    answered = sum(answer.verdict == "faulty" for answer in report.found)
    parts = [
        f"<p>Of {faulty} faulty windows of this month {answered} were answered by who looked at the"
        " machine.</p>"
    ]
    rows = [
        (
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
        for answer in report.found
    ]
    head = ("Finding", "Said", "With", "Found", "Cause", "Part", "Order", "By", "Note")
    parts += [_table(head, rows, numbers=(2,))] if rows else []
    of_machine, of_plant = said_and_found(report.found), said_and_found(report.plant)
    if not of_plant.lines:
        return "".join([*parts, "<p>No finding that said a probability was answered yet.</p>"])
    series = {"this machine, this month": of_machine.lines, "the plant until then": of_plant.lines}
    drawn = {name: lines for name, lines in series.items() if lines}
    parts += [reliability_svg(drawn), _bins(of_plant)]
    return "".join(parts)


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
        '<p class="muted small">Intervals after Clopper and Pearson, for findings that were answered'
        " independently of each other: several windows of one repair count too often. Only answered"
        f" findings are counted.{more}</p>"
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
    order = np.argsort(np.array([at.timestamp() for at in series.at]), kind="stable")
    day = np.array([(at - report.span.begin).total_seconds() / 86400 + 1 for at in series.at])[
        order
    ]
    value, low, high = (
        np.array(numbers)[order] for numbers in (series.value, series.low, series.high)
    )
    curves = [Curve(name, day, value)]
    edges = [edge for edge in (low, high) if np.isfinite(edge).any()]
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
    return f'<div class="scroll">{table}</div>'


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
