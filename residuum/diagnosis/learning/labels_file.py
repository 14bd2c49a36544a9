"""Labels of records, from a CSV file."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

from residuum.identification.errors import BadInput


def read_labels(file: Path, records: Sequence[Path]) -> tuple[list[str], list[str] | None]:
    """Label and exemplar of each record from a CSV of `record,label[,exemplar]` (record by file
    name or path).
    """
    table = _rows(file)
    columns = len(table[0]) if table else 2
    for number, row in enumerate(table, start=1):
        if len(row) != columns or columns not in (2, 3):
            raise BadInput(
                f"{file}, row {number}: must be record,label or record,label,exemplar, the same in"
                " every row"
            )
    known = {row[0]: row[1:] for row in table if row[:2] != ["record", "label"]}
    labels: list[str] = []
    exemplars: list[str] = []
    for record in records:
        label = known.get(str(record), known.get(record.name))
        if label is None:
            raise BadInput(f"{file}: has no label for {record}")
        labels.append(label[0])
        exemplars += label[1:]
    return labels, exemplars if columns == 3 else None


def _rows(file: Path) -> list[list[str]]:
    """The cells of a CSV file, lines of comment left out."""
    try:
        with file.open(encoding="utf-8", newline="") as rows:
            filled = [row for row in csv.reader(rows) if row and not row[0].startswith("#")]
            return [[cell.strip() for cell in row] for row in filled]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise BadInput(f"{file}: cannot be read as CSV: {error}") from None
