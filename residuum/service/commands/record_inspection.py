"""What is understood of a record file that says itself how it is read: channels, units, rate, what is left out, first rows."""

from pathlib import Path
from typing import Any

import numpy as np

from residuum.identification.record import Record
from residuum.identification.record_formats import read_record

SHOWN = 3
"""Rows as read that are shown."""


def inspect_record(file: Path) -> tuple[dict[str, Any], str]:
    """(JSON object, text for people) of a record file; the reader's refusal where it is not read."""
    record = read_record(file)
    return _plain(file, record), _human(file, record)


def first_rows(record: Record) -> list[list[float | None]]:
    """Time and values of the first samples, None for what is missing."""
    columns = [record.time, *record.channels.values()]
    rows = [[float(column[k]) for column in columns] for k in range(min(SHOWN, record.n))]
    return [[None if np.isnan(value) else value for value in row] for row in rows]


def _plain(file: Path, record: Record) -> dict[str, Any]:
    return {
        "file": str(file),
        "guesses": [],
        "columns": [
            {"column": k, "name": name, "unit": record.units[name], "missing": int(record.missing(name).sum())}
            for k, name in enumerate(record.names, start=1)
        ],
        "samples": {"rows": record.n, "sample_time": record.sample_time, "rate": record.sampling_rate, "even": True},
        "notes": list(record.notes),
        "first_rows": first_rows(record),
    }


def _human(file: Path, record: Record) -> str:
    lines = [
        f"{file}: {record.n} samples of {record.sample_time:.6g} s, {len(record.names)} channels, {record.sampling_rate:.6g} Hz"
    ]
    lines += [f"  {note}" for note in record.notes]
    for name in record.names:
        lines.append(f"  {name} [{record.units[name]}], {int(record.missing(name).sum())} missing")
    if bare := [name for name in record.names if not record.units[name]]:
        lines.append(f"  without a unit: {', '.join(bare)}; --unit COLUMN=UNIT says it to the commands")
    for row in first_rows(record):
        lines.append("  " + ", ".join("missing" if value is None else f"{value:.12g}" for value in row))
    return "\n".join(lines)
