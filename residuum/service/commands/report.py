"""What a command prints: a short human report, or with --json exactly one JSON object."""

import re
import sys
from collections.abc import Mapping
from typing import Annotated, Any

import orjson
import typer

from residuum.library.answers.plain import to_plain

__all__ = ["PROGRESS", "AsJson", "progress", "report", "to_plain"]

PROGRESS = re.compile(r"(\d{1,3}) % (.+)")
"""A line of progress that tells the share done."""
AsJson = Annotated[
    bool, typer.Option("--json", help="Print one JSON object on standard output and nothing else.")
]


def report(result: Mapping[str, Any], human: str, *, as_json: bool) -> None:
    """Print `result` as one JSON object, or the human text."""
    # Always one object on one line: programs read standard output whole, so progress and warnings
    # go to standard error.
    typer.echo(orjson.dumps(to_plain(result)).decode() if as_json else human)


def progress(message: str, share: float | None = None) -> None:
    """Say on standard error what a long command does; with the share done 0 … 1 in front, for who
    watches it at a terminal.

    Where nobody watches, standard error holds what went wrong and nothing else.

    >>> PROGRESS.fullmatch("40 % comparing").groups()
    ('40', 'comparing')
    """
    if share is None or sys.stderr.isatty():
        typer.echo(message if share is None else f"{100 * share:.0f} % {message}", err=True)


def tell_progress(share: float, message: str) -> None:
    """`progress`, in the order in which the library tells it."""
    progress(message, share)
