"""LabVIEW measurement files (LVM): their head says separator, decimal sign, units, start and step;
nothing is guessed.
"""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.errors import BadRecord
from residuum.identification.record import Record
from residuum.identification.record_formats.csv import read_csv
from residuum.identification.record_formats.loggers.logger_head import unit_of_head, unit_word
from residuum.identification.record_formats.loggers.logger_text import (
    MISSING,
    decoded,
    number,
    plain,
)
from residuum.identification.record_formats.options import ReadOptions
from residuum.identification.record_formats.time_bases import NOT_READ, TimedChannel, on_one_base

_FIRST = b"LabVIEW Measurement"
_END = "***End_of_Header***"
LONGEST_HEAD = 1 << 20
"""Bytes within which both heads end."""
_X_COLUMNS = ("no", "one", "multi")
_SEPARATORS = {"tab": "\t", "comma": ",", "semicolon": ";"}


def read_lvm(path: str | Path, options: ReadOptions = ReadOptions()) -> Record:
    """Read the channels of a LabVIEW measurement file; a file without both of LabVIEW's heads is
    read as any logger's.

    Times are its X column (seconds), or `X0` and `Delta_X` where it has none. A column `Comment`
    and cells of text are not read.

    Raises BadRecord with the row for a file of several segments, a row of the wrong width, a cell
    that is no number.
    """
    path = Path(path)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise BadRecord(f"{path}: cannot be read: {error.strerror}") from None
    if not has_head(content):
        return read_csv(path, options)
    return parse_lvm(content, str(path), options)


def has_head(content: bytes) -> bool:
    """Whether a file has both of LabVIEW's heads, which say how it is read; its first
    `LONGEST_HEAD` bytes are enough.
    """
    start = plain(content[:LONGEST_HEAD])
    return start.startswith(_FIRST) and start.count(_END.encode()) >= 2


def parse_lvm(content: bytes, source: str, options: ReadOptions = ReadOptions()) -> Record:
    """Read the bytes of a LabVIEW measurement file (see `read_lvm`)."""
    lines = decoded(content, source)[0].splitlines()
    ends = [row for row, line in enumerate(lines) if line.startswith(_END)]
    if len(ends) != 2:
        raise BadRecord(
            f"{source}: has {max(0, len(ends) - 1)} segments; one is read, save one file a segment"
        )
    general = _keys(lines[: ends[0]], None)
    cut, decimal = _signs(general, source)
    segment = _keys(lines[ends[0] + 1 : ends[1]], cut)
    # behind the second head: a line of names, then the samples
    heads = [cell.strip() for cell in "".join(lines[ends[1] + 1 : ends[1] + 2]).split(cut)]
    samples = lines[ends[1] + 2 :]
    count_cell = segment.get("Channels", ["0"])[0]
    n_channels = int(count_cell) if count_cell.isdigit() else 0
    places = _places(general.get("X_Columns", ["No"])[0].lower().strip("\t,; "), n_channels, source)
    width = max(map(max, places)) + 1
    table = _table(samples, cut, decimal, width, ends[1] + 3, source)
    channels = []
    for k, (at_x, at_y) in enumerate(places):
        name, unit = _name_and_unit(heads, segment, k, at_y)
        times = table[:, at_x]
        # `X_Columns No` leaves the column of times empty, and the head says start and step.
        if np.isnan(times).all():
            times = _even_times(segment, k, decimal, len(table), source)
        known = ~np.isnan(times)
        channels.append(TimedChannel(name, unit, times[known], table[known, at_y]))
    return on_one_base(channels, source, options, _not_read(samples, cut, width, heads))


def _signs(general: dict[str, list[str]], source: str) -> tuple[str, str]:
    """(what cuts cells, decimal sign) as the general head says them."""
    separator = general.get("Separator", ["tab"])[0].strip("\t,; ")
    cut = _SEPARATORS.get(separator.lower())
    # Taken for tabs, as it once was, one column would be read as good.
    if cut is None:
        raise BadRecord(
            f"{source}: its head says the separator {separator!r}; it must be one of"
            f" {', '.join(_SEPARATORS)}"
        )
    decimal = general.get("Decimal_Separator", ["."])[0][:1] or "."
    if decimal not in (".", ","):
        raise BadRecord(
            f"{source}: its head says the decimal sign {decimal!r}; it must be a point or a comma"
        )
    return cut, decimal


def _name_and_unit(
    heads: list[str], segment: dict[str, list[str]], k: int, column: int
) -> tuple[str, str]:
    """Name and unit of channel k; a label of the segment's head goes before brackets in a name."""
    head = heads[column] if column < len(heads) else ""
    name, unit = unit_of_head(head or f"channel {k + 1}")
    labels = segment.get("Y_Unit_Label", [])
    return name, unit_word(labels[k]) if k < len(labels) and labels[k] else unit


def _even_times(
    segment: dict[str, list[str]], k: int, decimal: str, n: int, source: str
) -> FloatArray:
    """The instants [s] of channel k by start and step of the segment's head, shape (n,)."""
    start = _number_of(segment, "X0", k, decimal, source)
    step = _number_of(segment, "Delta_X", k, decimal, source)
    if not step > 0:
        raise BadRecord(
            f"{source}: says neither times nor a Delta_X above 0; write one into its head"
        )
    times: FloatArray = start + step * np.arange(n, dtype=np.float64)
    return times


def _not_read(samples: Sequence[str], cut: str, width: int, heads: list[str]) -> tuple[str, ...]:
    """The note on what stands beside the channels, where something does."""
    if not any(any(map(str.strip, line.split(cut)[width:])) for line in samples):
        return ()
    return (f"{NOT_READ}{', '.join(heads[width:]) or 'what stands beside the channels'} (text)",)


def _keys(lines: Sequence[str], cut: str | None) -> dict[str, list[str]]:
    """Key → its values, of the lines of a head; the general one does not say yet what cuts its
    cells.
    """
    keys = {}
    for line in lines:
        cells = line.split(cut) if cut else re.split(r"[\t;,]", line, maxsplit=1)
        keys[cells[0].strip()] = [cell.strip() for cell in cells[1:]] or [""]
    return keys


def _places(x_columns: str, n: int, source: str) -> list[tuple[int, int]]:
    """Column of the times and of the values of each channel."""
    if n < 1 or n > 1000:
        raise BadRecord(f"{source}: its head says {n} channels; 1 to 1000 are read")
    if x_columns not in _X_COLUMNS:
        raise BadRecord(
            f"{source}: its head says X_Columns {x_columns!r}; it must be one of"
            f" {', '.join(_X_COLUMNS)}"
        )
    return (
        [(2 * k, 2 * k + 1) for k in range(n)]
        if x_columns == "multi"
        else [(0, k + 1) for k in range(n)]
    )


def _table(
    lines: Sequence[str], cut: str, decimal: str, width: int, first_row: int, source: str
) -> np.ndarray:
    rows = []
    for row, line in enumerate(lines, start=first_row):
        if not line.strip():
            continue
        cells = [cell.strip() for cell in line.split(cut)[:width]]
        if len(cells) < width:
            raise BadRecord(f"{source}, row {row}: {len(cells)} cells; its head says {width}")
        try:
            rows.append(
                [np.nan if cell.lower() in MISSING else number(cell, decimal) for cell in cells]
            )
        except ValueError:
            raise BadRecord(
                f"{source}, row {row}: holds a cell that is no number with decimal sign {decimal!r}"
            ) from None
    if len(rows) < 2:
        raise BadRecord(f"{source}: has {len(rows)} data rows; at least 2 are needed")
    return np.array(rows)


def _number_of(segment: dict[str, list[str]], key: str, k: int, decimal: str, source: str) -> float:
    """What the head says of channel k; 0 where it says nothing."""
    values = segment.get(key, [])
    cell = values[k] if k < len(values) else ""
    try:
        return number(cell, decimal) if cell else 0.0
    except ValueError:
        # Read as 0, as it once was, it would give a wrong time base as good.
        fault = (
            f"{key} of channel {k + 1} is {cell[:40]!r}, no number with decimal sign {decimal!r}"
        )
        raise BadRecord(f"{source}: {fault}; mend the head") from None
