"""What a command prints: a short human report, or with --json exactly one JSON object."""

import math
import re
import sys
from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
import orjson
import typer

PROGRESS = re.compile(r"(\d{1,3}) % (.+)")
"""A line of progress that tells the share done."""
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object on standard output and nothing else.")]


def report(result: Mapping[str, Any], human: str, *, as_json: bool) -> None:
    """Print `result` as one JSON object, or the human text."""
    typer.echo(orjson.dumps(to_plain(result)).decode() if as_json else human)


def progress(message: str, share: float | None = None) -> None:
    """Say on standard error what a long command does; with the share done 0 … 1 in front, for who watches it at a terminal.

    Where nobody watches, standard error holds what went wrong and nothing else.

    >>> PROGRESS.fullmatch("40 % comparing").groups()
    ('40', 'comparing')
    """
    if share is None or sys.stderr.isatty():
        typer.echo(message if share is None else f"{100 * share:.0f} % {message}", err=True)


def to_plain(value: Any) -> Any:
    """JSON values only: arrays become lists, NumPy numbers Python ones, non-finite numbers null."""
    if isinstance(value, Mapping):
        return {str(key): to_plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return to_plain(value.tolist())
    if isinstance(value, list | tuple):
        return [to_plain(item) for item in value]
    if isinstance(value, np.generic):
        return to_plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
