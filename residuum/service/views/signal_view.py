"""What a page shows of a long signal: minimum and maximum an interval.

Every `interval` keeps its extremes, so a peak of one sample survives any reduction; picking one
sample an interval (largest-triangle and the like) can lose it.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.diagnosis.residuals.residual_design import ResidualDesign
from residuum.diagnosis.residuals.residual_detection import Detection, detect
from residuum.identification.errors import BadInput
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.identified_model_file import load_identified
from residuum.identification.record import Record
from residuum.library.questions.residual import DesignResidual, RunResidual, residual_for
from residuum.service.store import ReadInPieces
from residuum.service.work.jobs import Progress
from residuum.service.work.worker_pool import RecordParts

# Intervals of all channels together, and of each: written as JSON in some 20 ms, in which nothing
# else is done.
_MOST_SHOWN, _FEWEST = 100_000, 10
# Of a sample: a time that is printed as a sample's own means that sample.
_NEXT = 1e-6


@dataclass(frozen=True, eq=False)
class Extremes:
    """Minimum and maximum of every `samples` samples, shapes (intervals,); NaN where an interval
    has no sample.
    """

    samples: int
    minimum: FloatArray
    maximum: FloatArray


def extremes(signal: npt.NDArray[Any], most: int) -> Extremes:
    """Reduce a signal of n samples to at most `most` intervals of equal length (the last may be
    shorter).

    Missing samples (NaN) are passed over; an interval of nothing else is NaN.

    >>> extremes(np.array([0.0, 5.0, -1.0, 2.0, np.nan]), 3).maximum.tolist()
    [5.0, 2.0, nan]
    """
    n = signal.shape[0]
    samples = max(1, -(-n // most))
    whole = n // samples
    body = signal[: whole * samples].reshape(whole, samples)
    # fmin and fmax pass NaN over: by min and max one missing sample would blank its whole interval.
    lowest, highest = np.fmin.reduce(body, axis=1), np.fmax.reduce(body, axis=1)
    remainder = n - whole * samples
    if remainder:
        lowest = np.append(lowest, np.fmin.reduce(signal[-remainder:]))
        highest = np.append(highest, np.fmax.reduce(signal[-remainder:]))
    return Extremes(samples, lowest.astype(np.float64), highest.astype(np.float64))


def extremes_of_pieces(pieces: Iterator[npt.NDArray[Any]], n: int, most: int) -> Extremes:
    """`extremes` of a signal of n samples that comes piece by piece.

    >>> pieces = iter([np.array([0.0, 5.0, -1.0]), np.array([2.0, np.nan])])
    >>> extremes_of_pieces(pieces, 5, 3).maximum.tolist()
    [5.0, 2.0, nan]
    """
    samples = max(1, -(-n // most))
    reduced, held = list[Extremes](), np.empty(0)
    for piece in pieces:
        held = np.concatenate([held, piece]) if len(held) else piece
        whole = len(held) // samples
        if whole:
            reduced.append(extremes(held[: whole * samples], whole))
            held = held[whole * samples :]
    if len(held):
        reduced.append(extremes(held, 1))
    return Extremes(
        samples,
        np.concatenate([part.minimum for part in reduced]),
        np.concatenate([part.maximum for part in reduced]),
    )


def stretch(
    pieces: Iterator[npt.NDArray[Any]], first: int, last: int
) -> Iterator[npt.NDArray[Any]]:
    """The samples first … last − 1 of a signal that comes piece by piece; it is taken to its end,
    where damage shows.
    """
    begin = 0
    for piece in pieces:
        inside = piece[max(0, first - begin) : max(0, last - begin)]
        if len(inside):
            yield inside
        begin += len(piece)


def signal_view(
    record: ReadInPieces, points: int, begin: float, end: float | None
) -> dict[str, Any]:
    """The `SignalAnswer` of a stretch of a record, without the window's number; BadInput when the
    stretch is empty.
    """
    first = min(int(begin / record.sample_time + _NEXT), record.n)
    last = record.n if end is None else min(record.n, int(end / record.sample_time + _NEXT) + 1)
    if last <= first:
        raise BadInput(
            f"query, from and to: no sample in {begin} … {end} s; the window lasts"
            f" {record.n * record.sample_time:.6g} s"
        )
    # All channels share what an answer may hold, so that a window of many does not take longer.
    points = min(points, max(_FEWEST, _MOST_SHOWN // len(record.units)))
    samples = max(1, -(-(last - first) // points))
    # Two samples an interval would be told by two numbers each: they are given as they are.
    reduced = samples > 2
    channels = {
        name: {
            "unit": unit,
            **_values(stretch(record.pieces(name), first, last), last - first, points, reduced),
        }
        for name, unit in record.units.items()
    }
    interval = record.sample_time * (samples if reduced else 1)
    return {
        "start": first * record.sample_time,
        "interval": interval,
        "reduced": reduced,
        "n": last - first,
        "channels": channels,
    }


def _values(pieces: Iterator[Any], n: int, points: int, reduced: bool) -> dict[str, Any]:
    if not reduced:
        return {"values": np.concatenate(list(pieces))}
    envelope = extremes_of_pieces(pieces, n, points)
    return {"minimum": envelope.minimum, "maximum": envelope.maximum}


# What a page draws of a residual generator: residual and statistic over time, and what a fault of
# some size costs or shows.
# The work of a job.

# Intervals of a residual that are drawn, and levels of its operating characteristic.
_POINTS, _LEVELS = 1500, 200


def read_identified(content: bytes) -> IdentifiedModel:
    """The identified model of a stored file."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "model.json"
        file.write_bytes(content)
        return load_identified(file)


def view_residual(
    progress: Progress,
    content: bytes,
    healthy: Sequence[RecordParts],
    record: RecordParts,
    offset: float | None,
    asked: DesignResidual,
    judged: RunResidual,
) -> Mapping[str, Any]:
    """Design a residual generator, run it on a record, and on its healthy records with and without
    a sensor offset.

    Parameters
    ----------
    content : bytes
        File of the identified model.
    offset : float or None
        Sensor offset of the receiver operating characteristic [output unit]; None: twice the
        noise's standard deviation.
    asked : DesignResidual
    judged : RunResidual

    Returns
    -------
    mapping
        `time`, `residual` (`lowest`, `highest`), `statistic` and `threshold` of the record;
        `alarm_time`; `roc`: shares of samples above a level, of healthy data (`false_alarms`) and
        of the same data with the offset (`detections`), by RMS of the residual.

    Raises
    ------
    BadInput
        Records that do not fit the model, or are too short for its memory.
    """
    model = read_identified(content)
    good, looked_at = [Record(*parts) for parts in healthy], Record(*record)
    progress(0.1, "designing the residual generator")
    design = residual_for(model, good, asked)
    progress(0.7, "running it")
    run = detect(design, looked_at, **judged.model_dump())
    size = 2 * design.noise.sigma if offset is None else offset
    return {
        **_over_time(design, looked_at, run),
        "roc": {"offset": size, **_characteristic(design, good, size)},
    }


def _over_time(design: ResidualDesign, record: Record, run: Detection) -> dict[str, Any]:
    residual, statistic = (
        np.where(run.signals.valid, values, np.nan)
        for values in (run.signals.robust, run.statistic)
    )
    reduced = extremes(residual, _POINTS)
    level = np.broadcast_to(np.asarray(run.threshold.level, dtype=float), (record.n,))
    first = run.first_alarm
    return {
        "unit": design.model.output_unit,
        "time": (np.arange(len(reduced.minimum)) * reduced.samples * record.sample_time).tolist(),
        "lowest": reduced.minimum.tolist(),
        "highest": reduced.maximum.tolist(),
        "statistic": extremes(statistic, _POINTS).maximum.tolist(),
        "threshold": extremes(level, _POINTS).minimum.tolist(),
        "threshold_unit": run.threshold.unit,
        "guarantee": run.threshold.guarantee,
        "alarm_time": None if first is None else first * record.sample_time,
        "false_alarms_per_day": run.threshold.false_alarms_per_day,
        "decoupling": design.post_filter.decoupling,
        "filter_order": design.post_filter.Q.order,
    }


def _characteristic(
    design: ResidualDesign, healthy: Sequence[Record], offset: float
) -> dict[str, Any]:
    """Share of samples whose windowed RMS residual passes a level, without and with a sensor
    offset.
    """
    output = design.model.output_name
    shifted = [replace(r, channels={**r.channels, output: r[output] + offset}) for r in healthy]
    without, with_fault = (np.sort(_statistics(design, records)) for records in (healthy, shifted))
    levels = np.quantile(np.concatenate([without, with_fault]), np.linspace(1, 0, _LEVELS))
    shares = [
        1 - np.searchsorted(values, levels, side="left") / len(values)
        for values in (without, with_fault)
    ]
    area = float(np.trapezoid(np.append(0.0, shares[1]), np.append(0.0, shares[0])))
    return {
        "level": levels.tolist(),
        "false_alarms": shares[0].tolist(),
        "detections": shares[1].tolist(),
        "area": area,
    }


def _statistics(design: ResidualDesign, records: Sequence[Record]) -> FloatArray:
    runs = [detect(design, record, threshold="posterior", evaluation="rms") for record in records]
    return np.concatenate([run.statistic[run.signals.valid] for run in runs])
