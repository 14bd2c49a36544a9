"""Oscilloscopes' text files whose head says what no column does: start and step of the samples, or
units beside the samples.
"""

import re

import numpy as np

from residuum.identification.errors import BadRecord
from residuum.identification.record import Record
from residuum.identification.record_formats.loggers.logger_head import unit_word
from residuum.identification.record_formats.loggers.logger_text import decoded, number, plain
from residuum.identification.record_formats.options import ReadOptions
from residuum.identification.record_formats.time_bases import TimedChannel, on_one_base

_COUNTED = re.compile(rb"\s*\"?X\"?,[^\r\n]*\bStart,Increment")
_BESIDE = re.compile(rb"\s*\"?Record Length\"?,[^\r\n,]*,\"?Points\"?,[^\r\n,]+,[^\r\n,]+")
_TIME, _VALUE = 3, 4  # columns beside the head's three
LONGEST_HEAD = 1 << 16
"""Bytes within which the head ends."""


def is_scope_csv(content: bytes) -> bool:
    """Whether a file begins as one of these: `X,CH1,…,Start,Increment`, or `Record
    Length,…,Points,time,value`.
    """
    start = plain(content[:LONGEST_HEAD])
    return bool(_COUNTED.match(start) or _BESIDE.match(start))


def parse_scope_csv(content: bytes, source: str, options: ReadOptions = ReadOptions()) -> Record:
    """Read the bytes of such a file; BadRecord with the row for a cell that is no number, or a head
    that lacks what it needs.
    """
    rows = [
        [cell.strip(' "') for cell in line.split(",")]
        for line in decoded(content, source)[0].splitlines()
    ]
    return (_counted if _COUNTED.match(plain(content[:LONGEST_HEAD])) else _beside)(
        rows, source, options
    )


def _counted(rows: list[list[str]], source: str, options: ReadOptions) -> Record:
    """The first column counts samples from `Start`, `Increment` seconds each; units stand below the
    names.
    """
    names, units = rows[0], rows[1] if len(rows) > 1 else []
    at = names.index("Start")
    if len(units) <= at + 1:
        raise BadRecord(f"{source}, row 2: holds no start and increment below their names")
    start, step = (_number(units, k, 2, source) for k in (at, at + 1))
    if not step > 0:
        raise BadRecord(f"{source}, row 2: increment {step:g} s; must be positive")
    samples = [(row, cells) for row, cells in enumerate(rows[2:], start=3) if any(cells)]
    time = start + step * np.array([_number(cells, 0, row, source) for row, cells in samples])
    channels = [
        TimedChannel(
            names[k],
            unit_word(units[k]),
            time,
            np.array([_number(cells, k, row, source) for row, cells in samples]),
        )
        for k in range(1, at)
        if names[k]
    ]
    return _record(channels, source, options)


def _beside(rows: list[list[str]], source: str, options: ReadOptions) -> Record:
    """Keys, values and units stand in the first three columns beside the samples' time and
    value.
    """
    head = {row[0]: row[1] for row in rows if len(row) > 1 and row[0]}
    if (unit := head.get("Horizontal Units", "s")) != "s":
        raise BadRecord(f"{source}: its times are in {unit!r}; seconds are read")
    samples = [(row, cells) for row, cells in enumerate(rows, start=1) if any(cells)]
    time, values = (
        np.array([_number(cells, k, row, source) for row, cells in samples])
        for k in (_TIME, _VALUE)
    )
    return _record(
        [TimedChannel(head.get("Source") or "CH1", head.get("Vertical Units", ""), time, values)],
        source,
        options,
    )


def _record(channels: list[TimedChannel], source: str, options: ReadOptions) -> Record:
    if not channels or len(channels[0].time) < 2:
        raise BadRecord(f"{source}: has no channel of two samples")
    return on_one_base(channels, source, options)


def _number(cells: list[str], column: int, row: int, source: str) -> float:
    cell = cells[column] if column < len(cells) else ""
    try:
        return number(cell, ".") if cell else float("nan")
    except ValueError:
        raise BadRecord(
            f"{source}, row {row}, column {column + 1}: {cell[:40]!r} is not a number"
        ) from None
