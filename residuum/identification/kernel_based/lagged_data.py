"""Records → the sums of a lagged regression: channels checked, missing samples left out, constant
levels eliminated.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.errors import BadRecord, NotIdentifiable
from residuum.identification.kernel_based.gram import RegressionSums, regression_sums
from residuum.identification.record import Record

# part of its size by which an input must differ from what the others add up to
_APART = 1e-3
_PART = 0.1
# samples at the begin by which an input is seen to stand still, and the part of its movement that
# must not be left out
_STILL, _LEFT_OUT = 3, 0.5


@dataclass(frozen=True, eq=False)
class LaggedData:
    """Sums over all records, and what is needed to bring levels and units back.

    `levels` holds for every record its own sums (signals taken from `input_levels`,
    `output_level`).
    """

    sums: RegressionSums
    sample_time: float
    input_units: tuple[str, ...]
    output_unit: str
    sources: tuple[str, ...]
    levels: tuple[tuple[RegressionSums, FloatArray, float], ...] = ()

    def offset(self, coefficients: FloatArray) -> float:
        """Output level at zero input that the coefficients leave, averaged over the records by
        their rows.
        """
        if not self.levels:
            return 0.0
        per_input = coefficients.reshape(len(self.input_units), -1).sum(axis=1)
        offsets = [
            output_level
            - per_input @ input_levels
            + (sums.output_sum - sums.regressor_sum @ coefficients) / sums.rows
            for sums, input_levels, output_level in self.levels
        ]
        return float(np.average(offsets, weights=[sums.rows for sums, _, _ in self.levels]))


def lagged_data(
    records: Record | Sequence[Record],
    inputs: Sequence[str],
    output: str,
    order: int,
    delay: int,
    *,
    offset: bool = True,
) -> LaggedData:
    """The regression of `output` on lags delay … delay + order − 1 of `inputs`, over one or several
    experiments.

    Raises BadRecord when a channel is absent, or the records differ in sample time or units;
    NotIdentifiable when an input or the output does not move, inputs move as one, or no row is
    complete.
    """
    experiments = [records] if isinstance(records, Record) else list(records)
    _check_alike(experiments, [*inputs, output])
    for name in inputs:
        _check_moves(
            experiments, name, "record while it is moved, by steps or at random", offset=offset
        )
    _check_moves(experiments, output, "take a channel that answers the input", offset=offset)
    if len(inputs) > 1:
        _check_apart(experiments, inputs, offset=offset)
    levels = [
        record_sums(record, inputs, output, order, delay, offset=offset) for record in experiments
    ]
    centred = [sums.centred() if offset else sums for sums, _, _ in levels]
    first = experiments[0]
    return LaggedData(
        reduce(add, centred),
        first.sample_time,
        tuple(first.units[name] for name in inputs),
        first.units[output],
        tuple(record.source for record in experiments),
        tuple(levels) if offset else (),
    )


def past_at_rest(inputs: Sequence[npt.NDArray[np.floating]], reach: int) -> int:
    """How many samples before the record the inputs are taken to have stood still, as they do at
    its beginning: 0 or `reach`.

    The rows of a step or a pulse that comes within `reach` samples have no whole past, and what is
    left has no movement. The past is taken from the beginning only there: three samples of every
    input alike, and most of its movement left out otherwise.

    >>> past_at_rest([np.r_[np.zeros(20), np.ones(280)]], 100), past_at_rest([np.arange(300.0) % 7], 100)
    (100, 0)
    """
    if any(len(u) <= _STILL or not (u[:_STILL] == u[0]).all() for u in inputs):
        return 0
    steps = [np.square(np.diff(u)) for u in inputs]
    late = any(np.nansum(step[: max(reach - 1, 0)]) > _LEFT_OUT * np.nansum(step) for step in steps)
    return reach if late else 0


def record_sums(
    record: Record, inputs: Sequence[str], output: str, order: int, delay: int, *, offset: bool
) -> tuple[RegressionSums, FloatArray, float]:
    """Sums of one record. Signals are taken from their own mean when a level is fitted, so that no
    digits are lost.
    """
    input_levels = np.array([_mean(record[name]) if offset else 0.0 for name in inputs])
    output_level = _mean(record[output]) if offset else 0.0
    signals, answer = [record[name] for name in inputs], record[output]
    # an output before the record is not known, so these rows only give later ones their past
    if before := past_at_rest(signals, delay + order - 1):
        signals = [np.concatenate([np.full(before, signal[0]), signal]) for signal in signals]
        answer = np.concatenate([np.full(before, np.nan), answer])
    try:
        sums = regression_sums(
            signals,
            answer,
            order,
            delay,
            input_levels=list(input_levels),
            output_level=output_level,
        )
    except NotIdentifiable as error:
        raise NotIdentifiable(f"{record.source or 'record'}: {error}") from None
    return sums, input_levels, output_level


def _check_alike(records: Sequence[Record], names: Sequence[str]) -> None:
    if not records:
        raise BadRecord("no record: at least one is needed")
    first = records[0]
    if len(set(names)) != len(names):
        raise BadRecord(
            f"channels {', '.join(names)}: each may be used once, as an input or as the output"
        )
    for record in records:
        for name in names:
            record[name]
            if record.units[name] != first.units[name]:
                where = f"{record.source or 'record'}, channel {name!r}"
                raise BadRecord(
                    f"{where}: unit {record.units[name]!r}, others have {first.units[name]!r}",
                    way_on=[("units", {name: "UNIT"}, "for all")],
                )
        if not math.isclose(record.sample_time, first.sample_time, rel_tol=1e-6):
            raise BadRecord(
                f"{record.source or 'record'}: sample time {record.sample_time:g} s, others have"
                f" {first.sample_time:g} s; all must be equal, resample one"
            )


def _check_apart(records: Sequence[Record], inputs: Sequence[str], *, offset: bool) -> None:
    """Refuse inputs of which one is a sum of multiples of the others, to a thousandth of its
    size.
    """
    signals = [
        np.stack([np.asarray(record[name], dtype=float) for name in inputs], axis=1)
        for record in records
    ]
    complete = [rows[np.isfinite(rows).all(axis=1)] for rows in signals]
    centred = np.concatenate(
        [rows - rows.mean(axis=0) if offset and len(rows) else rows for rows in complete]
    )
    size = np.linalg.norm(centred, axis=0)
    if not np.all(size > 0):
        return  # one that moves only where another is missing: the rows tell
    # the smallest eigenvalue of the correlations is the square of what one input has of its own
    eigenvalues, vectors = np.linalg.eigh((centred / size).T @ (centred / size))
    if eigenvalues[0] > _APART**2:
        return
    alike = [
        repr(name) for name, part in zip(inputs, vectors[:, 0], strict=True) if abs(part) > _PART
    ]
    raise NotIdentifiable(
        f"inputs {' and '.join(alike)} move as one (multiples of each other, or sums of them):"
        " their effects cannot be told apart; leave one out, or record them moving apart"
    )


def _check_moves(records: Sequence[Record], name: str, helps: str, *, offset: bool) -> None:
    """Refuse a signal that is constant (or zero, when its level counts) in every record, or never
    there.
    """
    spans = []
    for record in records:
        lowest, highest = float(np.fmin.reduce(record[name])), float(np.fmax.reduce(record[name]))
        if not math.isnan(lowest):
            size = max(abs(lowest), abs(highest))
            # rounding of a constant is no movement
            spans.append(highest - lowest > 1e-13 * size if offset else size > 0)
    if not any(spans):
        defect = "is constant" if spans and offset else "is zero" if spans else "has no sample"
        what_helps = helps if spans else "take a channel that was recorded"
        raise NotIdentifiable(
            f"channel {name!r} {defect}: it is persistently exciting of order 0; nothing can be"
            f" identified from it; {what_helps}"
        )


def _mean(signal: npt.NDArray[np.floating]) -> float:
    mean = float(signal.mean(dtype=float))
    return float(np.nanmean(signal, dtype=float)) if math.isnan(mean) else mean
