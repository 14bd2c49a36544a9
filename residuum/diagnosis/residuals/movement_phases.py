"""In which phase of a movement, and in which direction, does a model err? Cells of a heat map, each
with its worst moment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.residual_analysis.locate import Axis

STANDSTILL, STEADY, GAINING, LOSING = "standstill", "steady", "speeding up", "slowing down"
_SLOW = 0.02  # of the largest speed: below it the machine stands, as `direction_of_movement` has it
_STEADY = 0.1  # of the 95 % quantile of |dx/dt|
_SMOOTHED = 0.005  # of the record's length: what dx/dt is averaged over
_FEWEST = 5
_LEVELS = ("low", "middle", "high")
_MOVING = ("velocity",)
_STORED = ("temperature", "level")


def phase_cells(
    records: Sequence[Sequence[Axis]], sample_times: Sequence[float], errors: Sequence[FloatArray]
) -> dict[str, Any] | None:
    """RMS of an error in every phase and direction of the movement.

    Phases of a velocity v are standstill (|v| under 2 % of its largest), steady (|dv/dt| under a
    tenth of its 95 % quantile), speeding up and slowing down (d|v|/dt > 0, < 0), directions forward
    and backward. Of a temperature or level the phases are thirds of its range and the directions
    rising, falling and steady.

    Parameters
    ----------
    records : sequence of axes, one a record
    sample_times : sequence of float [s]
    errors : sequence of array, one a record
        Missing term or residual, NaN where unknown.

    Returns
    -------
    mapping or None
        `axis`, `phases`, `directions` and `cells`: `phase`, `direction`, `rms`, `share` of the
        error's power, `time_share`, and `record` (index) and `time` [s] of the largest error. Cells
        of fewer than 5 samples are left out. None without a velocity, temperature or level.
    """
    chosen = [_axis_of_movement(axes) for axes in records]
    first = chosen[0] if chosen else None
    if first is None:
        return None
    label = _movement if first.kind in _MOVING else _storage
    # one scale for all records: what stands in one would else be a movement of its own size
    sizes = [np.nanmax(np.abs(axis.values), initial=0.0) for axis in chosen if axis is not None]
    scale = float(max(sizes))
    labels = [
        label(axis.values, dt, scale)
        for axis, dt in zip(chosen, sample_times, strict=True)
        if axis is not None
    ]
    phase, direction = np.concatenate(labels, axis=1)
    samples = _Samples.of(sample_times, errors)
    phases, directions = _NAMES[label]
    cells = []
    for p, d in product(phases, directions):
        inside = samples.known & (phase == p) & (direction == d)
        if np.count_nonzero(inside) >= _FEWEST:
            cells.append({"phase": p, "direction": d, **samples.cell(inside)})
    return {
        "axis": first.name,
        "phases": list(phases),
        "directions": list(directions),
        "cells": cells,
    }


def _axis_of_movement(axes: Sequence[Axis]) -> Axis | None:
    """The first velocity, or else the first temperature or level."""
    return next((axis for kinds in (_MOVING, _STORED) for axis in axes if axis.kind in kinds), None)


@dataclass(frozen=True, eq=False)
class _Samples:
    """The squared error of every sample of all records, one after the other, where it is known, and
    the record (its index) and the time [s] that each sample is of; all of shape (samples,).
    """

    power: FloatArray
    known: npt.NDArray[np.bool_]
    record: npt.NDArray[np.int64]
    time: FloatArray

    @classmethod
    def of(cls, sample_times: Sequence[float], errors: Sequence[FloatArray]) -> _Samples:
        power = np.concatenate(errors) ** 2
        record = np.repeat(np.arange(len(errors)), [len(error) for error in errors])
        times = [dt * np.arange(len(error)) for dt, error in zip(sample_times, errors, strict=True)]
        return cls(power, np.isfinite(power), record, np.concatenate(times))

    def cell(self, inside: npt.NDArray[np.bool_]) -> dict[str, Any]:
        """RMS of the error in these samples, their share of its power and of the time, and where
        the largest of them is.
        """
        worst = int(np.argmax(np.where(inside, self.power, -1.0)))
        total = float(self.power[self.known].sum())
        return {
            "rms": float(np.sqrt(self.power[inside].mean())),
            "share": float(self.power[inside].sum()) / total if total > 0 else 0.0,
            "time_share": float(np.count_nonzero(inside) / np.count_nonzero(self.known)),
            "record": int(self.record[worst]),
            "time": float(self.time[worst]),
        }


def _rate(x: FloatArray, sample_time: float) -> FloatArray:
    """dx/dt of x averaged over half a percent of the record."""
    width = min(len(x), 2 * (int(_SMOOTHED * len(x)) // 2) + 1)
    padded = np.pad(np.where(np.isfinite(x), x, 0.0), width // 2, mode="edge")
    smooth = np.convolve(padded, np.ones(width) / width, mode="valid")
    return np.gradient(smooth, sample_time) if len(x) > 1 else np.zeros(len(x))


def _steady(rate: FloatArray) -> npt.NDArray[np.bool_]:
    return np.asarray(np.abs(rate) <= _STEADY * np.quantile(np.abs(rate), 0.95))


def _movement(
    v: FloatArray, sample_time: float, scale: float
) -> tuple[npt.NDArray[np.str_], npt.NDArray[np.str_]]:
    rate = _rate(v, sample_time)
    phase = np.where(rate * v > 0, GAINING, LOSING)
    phase = np.where(_steady(rate), STEADY, phase)
    phase = np.where(np.abs(v) <= _SLOW * scale, STANDSTILL, phase)
    return phase, np.where(v >= 0, "forward", "backward")


def _storage(
    x: FloatArray, sample_time: float, _scale: float
) -> tuple[npt.NDArray[np.str_], npt.NDArray[np.str_]]:
    rate = _rate(x, sample_time)
    low, span = float(np.nanmin(x)), float(np.ptp(x[np.isfinite(x)]))
    third = np.clip(np.nan_to_num(3 * (x - low) / (span or 1.0)).astype(int), 0, 2)
    direction = np.where(_steady(rate), "steady", np.where(rate > 0, "rising", "falling"))
    return np.asarray(_LEVELS)[third], direction


_NAMES = {
    _movement: ((STANDSTILL, GAINING, STEADY, LOSING), ("forward", "backward")),
    _storage: (_LEVELS, ("rising", "steady", "falling")),
}
