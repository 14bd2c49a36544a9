"""Readings in which a sensor says that it has nothing to say: single rows far beside their neighbours, spans that stand still.

A row is far beside where it lies off the median of the five rows about it by more than ten robust spreads of the steps between
rows and by more than half of the range of all other values; a step is none, for the median follows it. A value that comes
again among such rows is an error code (−127, 85, −999.9 …): no plant gives the very same number twice where it should give none.
A span stands still where it is several times longer than any usual run of equal values, while the model moves by far more than a
digit.

Fails for a plant that really jumps for one or two samples: such rows are told, and only codes are left out.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from residuum.identification.physics import PhysicalModel
from residuum.identification.physics.simulate.experiment import Experiment

FloatArray = npt.NDArray[np.float64]
_ABOUT = 5
_SPREADS, _OF_RANGE = 10.0, 0.5
_MOST = 0.05
"""Part of all rows: of more, they are no exceptions."""
_LONG, _TIMES, _DIGITS = 20, 5.0, 5.0
"""Rows, usual runs and least steps by which a still span stands out."""
_FEWEST = 30
_SHOWN = 12


@dataclass(frozen=True, eq=False)
class OddReadings:
    """Of one output in one record: rows far beside (numbers from 0), those that are error codes, the codes, and still spans."""

    output: str
    unit: str
    source: str
    beside: npt.NDArray[np.intp]
    codes: tuple[float, ...]
    coded: npt.NDArray[np.intp]
    still: tuple[tuple[int, int], ...]
    distance: tuple[float, float]

    @property
    def rows(self) -> list[int]:
        """All of them that are still among what is compared."""
        alone = np.setdiff1d(self.beside, self.coded).tolist()
        return [*alone, *(row for first, last in self.still for row in range(first, last + 1))]

    def says(self) -> list[str]:
        """A sentence of each kind."""
        found = []
        where = f"{self.source}, {self.output}"
        if self.coded.size:
            marks = " ".join(f"--missing {code:.10g}" for code in self.codes)
            values = " or ".join(f"{code:.10g}" for code in self.codes)
            found.append(
                f"{where}: {self._rows(self.coded)} read {values} {self.unit}, an error code beside their neighbours; they are "
                f"left out here; `residuum inspect FILE {marks}` leaves them out everywhere"
            )
        alone = np.setdiff1d(self.beside, self.coded)
        if alone.size:
            near, far = self.distance
            found.append(
                f"{where}: {self._rows(alone)} lie {near:.3g} to {far:.3g} {self.unit} beside their neighbours and make much of "
                "the error; where they mean no value, say --missing VALUE"
            )
        if self.still:
            spans = ", ".join(f"{first} to {last}" for first, last in self.still[:_SHOWN])
            found.append(f"{where}: stands still in samples {spans} while the model moves: a sensor that held its last value?")
        return found

    @staticmethod
    def _rows(rows: npt.NDArray[np.intp]) -> str:
        shown = ", ".join(map(str, rows[:_SHOWN])) + ", …" * (len(rows) > _SHOWN)
        return f"{len(rows)} single sample{'s' * (len(rows) > 1)} (number{'s' * (len(rows) > 1)} {shown})"


def odd_readings(model: PhysicalModel, experiments: Sequence[Experiment], simulated: Sequence[FloatArray]) -> list[OddReadings]:
    """What stands out of every measured output, beside `simulated` (n, outputs) an experiment."""
    found = []
    for experiment, beside in zip(experiments, simulated, strict=True):
        for k, name in enumerate(model.outputs):
            y = experiment.Y[:, k]
            if np.isfinite(y).sum() < _FEWEST:
                continue
            rows, codes, off = far_beside(y)
            coded = rows[np.isin(y[rows], codes)]
            alone = off[~np.isin(rows, coded)]
            distance = (float(alone.min()), float(alone.max())) if alone.size else (0.0, 0.0)
            still = _still(np.where(np.isin(np.arange(len(y)), rows), np.nan, y), beside[:, k])
            if rows.size or still:
                unit = str(model.outputs[name].unit)
                found.append(OddReadings(name, unit, experiment.source, rows, codes, coded, still, distance))
    return found


def without_codes(model: PhysicalModel, experiments: Sequence[Experiment]) -> tuple[list[Experiment], list[OddReadings]]:
    """The experiments with error codes missing, and what was found."""
    found = odd_readings(model, experiments, [np.full_like(each.Y, np.nan) for each in experiments])
    mended = []
    for experiment in experiments:
        Y = experiment.Y.copy()
        for odd in found:
            if odd.source == experiment.source and odd.coded.size and odd.coded[-1] < len(Y):
                column = list(model.outputs).index(odd.output)
                rows = odd.coded[np.isin(Y[odd.coded, column], odd.codes)]
                Y[rows, column] = np.nan
        mended.append(replace(experiment, Y=Y))
    return mended, found


def far_beside(y: FloatArray) -> tuple[npt.NDArray[np.intp], tuple[float, ...], FloatArray]:
    """Rows far beside the median of those about them, the values that come again among these, and how far each row is.

    >>> y = np.sin(np.arange(200) / 20)
    >>> y[[30, 90, 150]] = 85.0, -127.0, 85.0
    >>> rows, codes, _ = far_beside(y)
    >>> rows.tolist(), codes
    ([30, 90, 150], (85.0,))
    """
    from scipy.ndimage import median_filter  # noqa: PLC0415

    known = np.flatnonzero(np.isfinite(y))
    values = y[known]
    off = np.abs(values - median_filter(values, _ABOUT, mode="nearest"))
    spread = 1.4826 * float(np.median(np.abs(np.diff(values)))) or float(np.median(off[off > 0])) if (off > 0).any() else 0.0
    far = off > _SPREADS * spread
    rest = values[~far]
    low, high = np.quantile(rest, [0.005, 0.995]) if rest.size else (0.0, 0.0)
    large = far & (off > _OF_RANGE * float(high - low))
    codes = tuple(sorted(value for value, count in Counter(values[large].tolist()).items() if count > 1))
    odd = large | (far & np.isin(values, codes))  # a code that is near what the sensor should show is one, too
    return (known[odd], codes, off[odd]) if 0 < odd.sum() <= _MOST * len(values) else (known[:0], (), off[:0])


def _still(y: FloatArray, simulated: FloatArray) -> tuple[tuple[int, int], ...]:
    """First and last row of spans that stand still while the model moves."""
    filled = y.copy()
    known = np.flatnonzero(np.isfinite(y))
    if len(known) < _FEWEST:
        return ()
    filled[np.isnan(y)] = np.interp(np.flatnonzero(np.isnan(y)), known, y[known])
    starts = np.flatnonzero(np.r_[True, filled[1:] != filled[:-1]])
    lengths = np.diff(np.r_[starts, len(filled)])
    steps = np.abs(np.diff(filled))
    digit = float(steps[steps > 0].min()) if (steps > 0).any() else 0.0
    usual = float(np.quantile(lengths, 0.9))
    spans = []
    for first, length in zip(starts, lengths, strict=True):
        part = simulated[first : first + length]
        moves = np.isfinite(part).any() and float(np.nanmax(part) - np.nanmin(part)) > _DIGITS * digit
        if length >= max(_LONG, _TIMES * usual) and digit and moves:
            spans.append((int(first), int(first + length - 1)))
    return tuple(spans)
