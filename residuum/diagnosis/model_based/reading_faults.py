"""What a sensor's readings show by themselves: that they stand still, drop out, or that their noise has grown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

_FEWEST = 20
"""Equal readings in a row that can be a stuck sensor."""
_TIMES = 3.0
"""… and as many times the longest run of healthy windows."""
_MOVES = 6.0
"""Standard deviations of its innovations by which the expected reading must move in that time."""
_FAR = 8.0
"""Deviations from which on a single reading was lost, not noisy."""
_OF_FAR = 0.1
"""Share of the readings that are far out (the filter, misled by a lost one, is off for some more) that were lost."""


@dataclass(frozen=True)
class Run:
    """Equal readings: from sample `first`, `length` of them, at `value`."""

    first: int
    length: int
    value: float


def longest_run(y: Array) -> Run:
    """The longest run of equal readings (missing ones end it)."""
    if not len(y):
        return Run(0, 0, np.nan)
    same = np.concatenate([[False], y[1:] == y[:-1], [False]])
    edges = np.flatnonzero(np.diff(same.astype(np.int8)))
    begins, ends = edges[::2], edges[1::2]
    if not len(begins):
        return Run(0, 1, float(y[0]))
    k = int(np.argmax(ends - begins))
    return Run(int(begins[k]), int(ends[k] - begins[k]) + 1, float(y[begins[k]]))


def stuck(y: Array, expected: Array, noise: float, healthy_run: int) -> Run | None:
    """The run in which a reading stands although it was expected to move; None where there is none.

    `expected` are the readings that were expected without this sensor, `noise` the standard deviation of what is left of them
    when healthy, `healthy_run` the longest run of equal readings of healthy windows.
    """
    run = longest_run(y)
    if run.length < max(_FEWEST, _TIMES * healthy_run):
        return None
    there = expected[run.first : run.first + run.length]
    return run if np.isfinite(there).all() and np.ptp(there) > _MOVES * noise else None


def lost_readings(deviation: Array, y: Array) -> npt.NDArray[np.bool_]:
    """Readings that are far out and stand at one value (zero, or an end of the range), in at least two places."""
    far = np.abs(np.nan_to_num(deviation)) > _FAR
    if np.count_nonzero(far) < 2:
        return np.zeros(len(y), dtype=bool)
    values, counts = np.unique(y[far], return_counts=True)
    value = values[int(np.argmax(counts))]
    lost = far & (y == value)
    begins = np.count_nonzero(np.diff(np.concatenate([[0], lost.astype(np.int8)])) == 1)
    usual = np.count_nonzero((y == value) & ~far)
    told = begins >= 2 and np.count_nonzero(lost) >= _OF_FAR * np.count_nonzero(far) and usual <= np.count_nonzero(lost)
    return lost if told else np.zeros(len(y), dtype=bool)
