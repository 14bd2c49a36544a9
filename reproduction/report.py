"""The report: one self-contained page."""

from collections.abc import Sequence
from html import escape
from pathlib import Path

from plotly.offline import get_plotlyjs

from reproduction.item import Item

_STYLE = """
body{font:15px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem;color:#1a1f26}
h2{margin:2.2rem 0 .2rem;font-size:1.15rem}table{border-collapse:collapse;margin:.6rem 0}
td,th{border:1px solid #cbd3dc;padding:.2rem .6rem;text-align:right}th{background:#f1f4f7}
.source{color:#4c5866}.yes{border-left:4px solid #2e7d4f;padding-left:.6rem}.no{border-left:4px solid #b3541e;padding-left:.6rem}
"""


def write_report(items: Sequence[Item], path: Path) -> None:
    """Write the page with every item, Plotly included once, so that it opens offline."""
    counted = [item for item in items if not (item.by_construction and item.agrees)]
    agree = sum(item.agrees for item in counted)
    parts = [
        "<!doctype html><html lang='en'><meta charset='utf-8'><title>Residuum: reproduction</title>",
        f"<style>{_STYLE}</style><script>{get_plotlyjs()}</script>",
        "<h1>The source's numbers beside ours</h1>",
        f"<p>{agree} of {len(counted)} items agree; where one does not, its line says how. "
        f"{len(items) - len(counted)} more hold by construction and are not counted.</p>",
        *(_section(item) for item in items),
    ]
    path.write_text("\n".join(parts), encoding="utf-8")


def _section(item: Item) -> str:
    figures = "".join(figure.to_html(full_html=False, include_plotlyjs=False) for figure in item.figures)
    return (
        f"<h2>{escape(item.where)}: {escape(item.title)}</h2><p class='source'>Source: {escape(item.source)}</p>"
        f"<p class='{'yes' if item.agrees else 'no'}'>{item.word.capitalize()}: {escape(item.says)}</p>"
        f"{_table(item.rows)}{figures}"
    )


def _table(rows: Sequence[Sequence[str]]) -> str:
    if not rows:
        return ""
    head = "".join(f"<th>{escape(cell)}</th>" for cell in rows[0])
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows[1:])
    return f"<table><tr>{head}</tr>{body}</table>"
