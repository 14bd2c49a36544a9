"""Trend: the same parameters estimated on a series of records; what grows is wear, what was always there is missing physics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.identification.blas_threads import one_thread
from residuum.identification.discrepancy.input_timing import experiments_and_base
from residuum.identification.physics import PhysicalModel
from residuum.identification.record import Record

FloatArray = npt.NDArray[np.float64]

SIGNIFICANT = 3.0
"""Slope over its standard deviation from which a parameter counts as changing."""


@dataclass(frozen=True, eq=False)
class Trend:
    """One parameter over a series: values and standard deviations (records,), slope per record with its own, in `unit`.

    `scatter` is the spread about the line that the standard deviations do not account for.
    """

    parameter: str
    unit: str
    values: FloatArray
    std: FloatArray
    slope: float
    slope_std: float
    scatter: float

    @property
    def changes(self) -> bool:
        """Whether the slope stands out of its uncertainty (wear), rather than being a constant of the machine."""
        return abs(self.slope) > SIGNIFICANT * self.slope_std


@one_thread()
def trends(model: PhysicalModel, records: Sequence[Record], mapping: Mapping[str, str] | None = None) -> list[Trend]:
    """Every free parameter of the model, its effects' included, estimated on each record by itself.

    A line is fitted by weighted least squares, weights 1/(std² + scatter²); fewer than three records give an infinite
    standard deviation of the slope.

    Raises
    ------
    BadRecord, BadUnit, NotIdentifiable
        As `explain` does, for any of the records.
    """
    fitted = [experiments_and_base(model, [record], mapping)[1] for record in records]
    known = model.all_parameters
    return [
        _line(name, known[name].unit, np.array([s.model.values[name] for s in fitted]), np.array([s.std[k] for s in fitted]))
        for k, name in enumerate(fitted[0].parameters)
    ]


def _line(name: str, unit: str, values: FloatArray, std: FloatArray) -> Trend:
    n = values.size
    usable = np.isfinite(std)
    if n < 3 or usable.sum() < 3:
        return Trend(name, unit, values, std, 0.0, float("inf"), 0.0)
    t, y, s = np.arange(n)[usable] - np.mean(np.arange(n)[usable]), values[usable], std[usable]
    rest = y - np.polyval(np.polyfit(t, y, 1), t)
    scatter = float(np.sqrt(max(0.0, np.sum(rest**2) / (usable.sum() - 2) - np.mean(s**2))))
    weights = 1.0 / np.maximum(s**2 + scatter**2, 1e-300)
    centred = t - np.sum(weights * t) / np.sum(weights)
    information = float(np.sum(weights * centred**2))
    slope = float(np.sum(weights * centred * y) / information)
    return Trend(name, unit, values, std, slope, float(1.0 / np.sqrt(information)), scatter)
