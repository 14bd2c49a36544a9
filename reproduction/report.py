"""The report: one self-contained page."""

from collections.abc import Sequence
from html import escape
from pathlib import Path

from plotly.offline import get_plotlyjs

from reproduction.check import Check
from reproduction.item import Item
from reproduction.tolerances import TOLERANCES

_STYLE = """
body{font:15px/1.5 system-ui,sans-serif;max-width:76rem;margin:2rem auto;padding:0 1rem;color:#1a1f26}
h2{margin:2.2rem 0 .2rem;font-size:1.15rem}table{border-collapse:collapse;margin:.6rem 0}
td,th{border:1px solid #cbd3dc;padding:.2rem .6rem;text-align:left;vertical-align:top}th{background:#f1f4f7}
.source{color:#4c5866}.agrees{color:#1f6b41}.differs{color:#b3541e;font-weight:600}.holds,.drawing{color:#4c5866}
.numbers td{text-align:right}
"""
_HEAD = ("what", "source", "ours", "difference", "says")


def write_report(items: Sequence[Item], lost: Sequence[tuple[str, str, str]], path: Path) -> None:
    """Write the page with every item, Plotly included once, so that it opens offline."""
    parts = [
        "<!doctype html><html lang='en'><meta charset='utf-8'><title>Residuum: reproduction</title>",
        f"<style>{_STYLE}</style><script>{get_plotlyjs()}</script>",
        "<h1>The source's numbers beside ours</h1>",
        f"<p>{escape(summary(items))}</p>",
        *(
            f"<p class='differs'>Agreed before, and not now: {escape(', '.join(one))}</p>"
            for one in lost
        ),
        _overview(items),
        *(_section(item) for item in items),
    ]
    path.write_text("\n".join(parts), encoding="utf-8")


def summary(items: Sequence[Item]) -> str:
    """How many items agree, differ, hold by construction, and are drawings."""
    words = [item.word for item in items]
    return (
        f"{words.count('agrees')} of {len(words) - words.count('drawing')} figures and tables with something "
        "to measure agree in "
        f"every check, {words.count('differs')} differ in at least one (its line says by how much, and why), "
        f"{words.count('holds by construction')} hold by construction alone; {words.count('drawing')} are drawings."
    )


def _overview(items: Sequence[Item]) -> str:
    """The summary table: a row an item, with its first check that differs and the reason."""
    head = "".join(
        f"<th>{name}</th>"
        for name in ("where", "what", "says", "checks that agree", "differs in", "reason")
    )
    return f"<table><tr>{head}</tr>{''.join(map(_overview_row, items))}</table>"


def _overview_row(item: Item) -> str:
    agree = (
        f"{sum(check.holds for check in item.counted)} of {len(item.counted)}"
        if item.checks
        else ""
    )
    differing = "; ".join(check.sentence for check in item.checks if not check.holds)
    cells = (
        item.title,
        _coloured(item.word),
        agree,
        differing,
        item.reason if item.differs or not item.checks else "",
    )
    shown = "".join(
        f"<td>{cell if cell.startswith('<span') else escape(cell)}</td>" for cell in cells
    )
    return f"<tr><td><a href='#{_anchor(item)}'>{escape(item.where)}</a></td>{shown}</tr>"


def _section(item: Item) -> str:
    figures = "".join(
        figure.to_html(full_html=False, include_plotlyjs=False) for figure in item.figures
    )
    reason = (
        f"<p>Reason: {escape(item.reason)}</p>"
        if item.reason and (item.differs or not item.checks)
        else ""
    )
    return (
        f"<h2 id='{_anchor(item)}'>{escape(item.where)}: {escape(item.title)}</h2><p class='source'>Source: "
        f"{escape(item.source)}</p>"
        f"<p>{_coloured(item.word)}</p>{_checks(item.checks)}{_allowed(item)}{reason}{_table(item.rows)}{figures}"
    )


def _allowed(item: Item) -> str:
    """Why the checks allow what they allow."""
    return (
        f"<p>What is allowed: {escape(TOLERANCES.get(item.where, ''))}</p>"
        if item.where in TOLERANCES
        else ""
    )


def _checks(checks: Sequence[Check]) -> str:
    if not checks:
        return ""
    head = "".join(f"<th>{name}</th>" for name in _HEAD)
    return f"<table><tr>{head}</tr>{''.join(map(_check_row, checks))}</table>"


def _check_row(check: Check) -> str:
    cells = "".join(
        f"<td>{escape(cell)}</td>"
        for cell in (check.name, check.source, check.ours, check.difference)
    )
    return f"<tr>{cells}<td>{_coloured(check.word)}</td></tr>"


def _coloured(word: str) -> str:
    return f"<span class='{word.split(maxsplit=1)[0]}'>{escape(word)}</span>"


def _anchor(item: Item) -> str:
    return "".join(letter if letter.isalnum() else "-" for letter in item.where)


def _table(rows: Sequence[Sequence[str]]) -> str:
    if not rows:
        return ""
    head = "".join(f"<th>{escape(cell)}</th>" for cell in rows[0])
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows[1:]
    )
    return f"<table class='numbers'><tr>{head}</tr>{body}</table>"
