"""The signals of an estimation: one input and one output of one or more records, scaled, complete,
checked.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.errors import BadRecord, NotIdentifiable
from residuum.identification.record import Record


@dataclass(frozen=True, eq=False)
class Signals:
    """(u, y) pairs of each record with the records' common mean removed and unit power, and how to
    undo that.

    `u_scale`, `y_scale`, `u_level`, `y_level` are in the channels' units: y_recorded = y_level +
    y_scale · y.
    """

    pairs: tuple[tuple[FloatArray, FloatArray], ...]
    u_level: float
    y_level: float
    u_scale: float
    y_scale: float

    @property
    def n(self) -> int:
        """Number of samples in all."""
        return sum(len(y) for _, y in self.pairs)


def signals(records: Sequence[Record], input: str | None, output: str, *, offset: bool) -> Signals:
    """Take the channels from the records; `input` None gives a zero input (time series).

    Raises
    ------
    BadRecord
        No record, a missing sample (these methods need every sample), records of different sample
        time.
    NotIdentifiable
        An output or input that does not move.
    """
    if not records:
        raise BadRecord("prediction error method: no record was given")
    _check_sample_times(records)
    ys = [_complete(record, output) for record in records]
    us = [
        np.zeros(len(y)) if input is None else _complete(record, input)
        for record, y in zip(records, ys, strict=True)
    ]
    u_level, u_scale = _level_and_scale(us, offset)
    y_level, y_scale = _level_and_scale(ys, offset)
    _check_movement(records[0].source or "record", (input, u_scale), (output, y_scale))
    u_scale = u_scale or 1.0  # the zero input of a time series stays zero
    pairs = tuple(
        ((u - u_level) / u_scale, (y - y_level) / y_scale) for u, y in zip(us, ys, strict=True)
    )
    return Signals(pairs, u_level, y_level, u_scale, y_scale)


def _check_movement(where: str, input: tuple[str | None, float], output: tuple[str, float]) -> None:
    """Refuse an output or an input, name and scale of each, that does not move."""
    if output[1] == 0.0:
        raise NotIdentifiable(
            f"{where}, channel {output[0]!r}: does not move; there is nothing to identify: take one"
            " that answers the input"
        )
    if input[0] is not None and input[1] == 0.0:
        raise NotIdentifiable(
            f"{where}, channel {input[0]!r}: does not move (excites order 0): record while it is"
            " moved"
        )


def _check_sample_times(records: Sequence[Record]) -> None:
    steps = {record.sample_time for record in records}
    if max(steps) - min(steps) > 1e-6 * min(steps):
        raise BadRecord(
            f"records: have sample times {sorted(steps)} s; all must be equal, resample one"
        )


def _complete(record: Record, name: str) -> FloatArray:
    signal = np.asarray(record[name], dtype=float)
    missing = np.flatnonzero(np.isnan(signal))
    where = record.source or "record"
    if missing.size == signal.size:
        raise BadRecord(
            f"{where}, channel {name!r}: has no sample; take a channel that was recorded"
        )
    if missing.size:
        raise BadRecord(
            f"{where}, channel {name!r}: sample {int(missing[0])} is missing; prediction error"
            " methods need every sample; cut the record there, or",
            way_on=[("method", "kernel")],
        )
    return signal


def _level_and_scale(parts: Sequence[FloatArray], offset: bool) -> tuple[float, float]:
    whole = np.concatenate(parts)
    level = float(whole.mean()) if offset else 0.0
    spread = float(np.sqrt(np.mean((whole - level) ** 2)))
    # rounding of the mean leaves a spread of a constant, too: its range tells
    moves = float(np.ptp(whole)) > 1e-12 * max(float(np.abs(whole).max()), 1e-300)
    return level, spread if moves else 0.0
