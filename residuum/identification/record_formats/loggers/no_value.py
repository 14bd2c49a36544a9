"""Numbers that instruments write where they have no value: an overload is taken for missing, what
only may be one is told.
"""

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from residuum.identification.record import Record, Signal

OVERLOAD = 1e30
"""No instrument measures this much in any unit; 9.9e37 is what meters and oscilloscopes write for
an overload.
"""
NO_VALUE = "no value: "
"""How a note begins that tells of such numbers."""
# nines, and the ends of integers of 16 and 32 bits
_MARK = re.compile(r"-?(9{3,}(\.9+)?|32767|32768|65535|2147483647|2147483648)")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?")
_APART = 2.0  # times the spread of all other values: so far away from them stands a mark


def without_overloads(record: Record) -> Record:
    """The record with overloads missing; the notes tell how many, and which numbers may be marks
    for no value.
    """
    channels, notes = dict(record.channels), list(record.notes)
    for name, signal in record.channels.items():
        channels[name], remarks = without_overload(name, signal)
        notes += remarks
    return (
        record
        if notes == list(record.notes)
        else replace(record, channels=channels, notes=tuple(notes))
    )


def without_marks(record: Record, cells: Sequence[str]) -> Record:
    """The record without the numbers among `cells`, which somebody said mean no value."""
    marks = [float(cell) for cell in cells if _NUMBER.fullmatch(cell.strip())]
    if not marks:
        return record
    channels, notes = dict(record.channels), list(record.notes)
    for name, signal in record.channels.items():
        if (marked := np.isin(signal, np.array(marks, dtype=signal.dtype))).any():
            channels[name] = np.where(marked, np.nan, signal)
            notes.append(
                f"{NO_VALUE}{name}: {int(marked.sum())} samples of {signal[marked][0]:.10g}, as was"
                " said"
            )
    return replace(record, channels=channels, notes=tuple(notes))


def without_overload(name: str, signal: Signal) -> tuple[Signal, list[str]]:
    """A channel, shape (n,), with overloads missing, and the notes on it and on what may be a mark
    for no value.
    """
    notes, over = [], np.abs(signal) >= OVERLOAD  # a comparison with NaN is false
    if over.any():
        notes.append(
            f"{NO_VALUE}{name}: {int(over.sum())} samples of {signal[over][0]:.9g} are an overload,"
            " taken as missing"
        )
        signal = np.where(over, np.nan, signal)
    return signal, notes + [
        f"{NO_VALUE}{name}: {_said(value, count)}" for value, count in _marks(np.asarray(signal))
    ]


def _said(value: float, count: int) -> str:
    cell = f"{value:.10g}"
    return (
        f"{count} samples of {cell}, far from all others, may mean that there is none; then read"
        f" the file with missing {cell}"
    )


def _marks(signal: Signal) -> list[tuple[float, int]]:
    """Values that are written as marks are and stand far from all others, with their number."""
    known = signal[np.isfinite(signal)]
    if not known.size:
        return []
    ends = {float(known.min()), float(known.max())}
    return [(end, int((known == end).sum())) for end in sorted(ends) if _is_mark(end, known)]


def _is_mark(value: float, known: npt.NDArray[np.floating]) -> bool:
    if not _MARK.fullmatch(f"{value:.10g}"):
        return False
    readings = known[known != value]
    return bool(readings.size) and bool(np.abs(readings - value).min() > _APART * np.ptp(readings))
