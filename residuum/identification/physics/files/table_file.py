"""Tables that stand in CSV files beside the model file: put into its expressions as lists, so that
a model is one text.

Two columns are places and values; more are a table of two places: the first row holds the second
places, the first column the first ones, and the corner anything. Lines that begin with # and a head
of names are left out.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

from residuum.identification.physics.files.expression import Place
from residuum.identification.physics.files.yaml_tree import Listing, Scalar, Table, Tree

T = TypeVar("T", bound=Tree)
_FILE = re.compile(r"[A-Za-z_][\w-]{0,60}\.csv\b")
_LARGEST = 100_000
"""Characters of a file."""


def with_table_files(tree: T, folder: Path | None) -> T:
    """The tree with the name of each file in a table's place replaced by what it holds.

    Raises
    ------
    BadModel
        With line and column: no such file in the folder, no folder (a model that came as a text),
        no table in it.
    """
    if isinstance(tree, Table):
        entries = {key: with_table_files(value, folder) for key, value in tree.entries.items()}
        return Table(entries, tree.keys, tree.place)  # type: ignore[return-value]
    if isinstance(tree, Listing):
        items = [with_table_files(item, folder) for item in tree.items]
        return Listing(items, tree.place)  # type: ignore[return-value]
    if "table(" not in tree.text:
        return tree
    return Scalar(
        _FILE.sub(lambda name: _lists(name[0], folder, tree.place), tree.text), tree.place
    )  # type: ignore[return-value]


def _lists(name: str, folder: Path | None, place: Place) -> str:
    """A file's table as the lists that stand behind what is looked up."""
    cells = csv.reader(_lines(name, folder, place))
    rows = [list(map(_number, row)) for row in cells]
    if rows and len(rows[0]) == 2 and not all(map(math.isfinite, rows[0])):
        rows = rows[1:]  # a head of names
    if not _is_table(rows):
        raise place.refuse(
            f"table {name!r}: must hold rows of numbers, all as long: place,value, or the values of"
            " two places"
        )
    if len(rows[0]) == 2:
        places, values = map(list, zip(*rows, strict=True))
        return f"{places}, {values}"
    first_places = [row[0] for row in rows[1:]]
    second_places = rows[0][1:]
    return f"{first_places}, {second_places}, {[row[1:] for row in rows[1:]]}"


def _lines(name: str, folder: Path | None, place: Place) -> list[str]:
    """The lines of a file that are neither empty nor comments."""
    if folder is None:
        raise place.refuse(
            f"table {name!r}: a model that is given as a text has no files beside it; write the"
            " values as lists"
        )
    try:
        with (folder / name).open(encoding="utf-8-sig", newline="") as file:
            text = file.read(_LARGEST)
    except (OSError, UnicodeDecodeError) as error:
        raise place.refuse(
            f"table {name!r}: cannot be read beside the model file ({error.__class__.__name__})"
        ) from None
    return [line for line in text.splitlines() if line.strip() and not line.startswith("#")]


def _is_table(rows: Sequence[Sequence[float]]) -> bool:
    """Whether there are two rows or more of numbers, all as long; the corner of a table of two
    places may hold anything.
    """
    if len(rows) < 2 or any(len(row) != len(rows[0]) for row in rows):
        return False
    first = rows[0][1:] if len(rows[0]) > 2 else rows[0]
    return all(math.isfinite(number) for row in (first, *rows[1:]) for number in row)


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan
