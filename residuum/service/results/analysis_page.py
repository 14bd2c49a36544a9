"""Records, and a model held against them, as one HTML page that can be sent: it opens offline and has no scripts."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from residuum.library.comparison import Comparison
from residuum.library.explanation import Explanation
from residuum.library.record import Record
from residuum.library.result import Result
from residuum.library.svg import svg
from residuum.service.results.report_page import section, whole_page, written_by


def analysis_page(title: str, records: Sequence[Record], answers: Sequence[Result]) -> str:
    """The page's text: each answer with its sentences and picture, then each record as it was read."""
    parts = [f"<h1>{escape(title)}</h1>", *(section(_question(answer), _answer(answer)) for answer in answers)]
    parts += [section(record.source or "record", _record(record)) for record in records]
    return whole_page(title, [*parts, written_by()])


def _question(answer: Result) -> str:
    """What an answer answers, as its heading."""
    if isinstance(answer, Explanation):
        return "What the model lacks"
    return "The model beside the records" if isinstance(answer, Comparison) else type(answer).__name__


def _answer(answer: Result) -> str:
    picture = answer.picture()
    return f"<pre>{escape(str(answer))}</pre>{svg(picture, len(picture.panels))}"


def _record(record: Record) -> str:
    picture = record.picture()
    notes = "".join(f"<p>{escape(note)}</p>" for note in record.notes)
    return f"<p>{escape(str(record))}</p>{notes}{svg(picture, len(picture.panels))}"
