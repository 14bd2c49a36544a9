"""What a sensor's readings show by themselves: that they stand still, drop out, or that their noise has grown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy

Array = npt.NDArray[np.float64]

_FEWEST = 20
"""Equal readings in a row that can be a stuck sensor."""
_TIMES = 3.0
"""… and as many times the longest run of healthy windows."""
_MOVES = 6.0
"""Standard deviations of its innovations by which the expected reading must move in that time."""
_FAR = 8.0
"""Deviations from which on a single reading was lost, not noisy."""
_NEIGHBOURS = 9
"""Readings around one that it is compared with."""


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


def stands(y: Array, healthy_run: int) -> bool:
    """Whether some run of equal readings is longer than healthy windows had."""
    return longest_run(y).length >= max(_FEWEST, _TIMES * healthy_run)


def stuck(y: Array, expected: Array, noise: float, healthy_run: int) -> Run | None:
    """The run in which a reading stands although it was expected to move; None where there is none.

    `expected` are the readings that were expected without this sensor, `noise` the standard deviation of what is left of them
    when healthy, `healthy_run` the longest run of equal readings of healthy windows.
    """
    if not stands(y, healthy_run):
        return None
    run = longest_run(y)
    there = expected[run.first : run.first + run.length]
    return run if np.isfinite(there).all() and np.ptp(there) > _MOVES * noise else None


def lost_readings(y: Array, noise: float) -> npt.NDArray[np.bool_]:
    """Readings far from their neighbours that stand at one value (zero, or an end of the range), in two places at least."""
    far = np.abs(y - scipy.signal.medfilt(y, _NEIGHBOURS)) > _FAR * noise
    if np.count_nonzero(far) < 2:
        return np.zeros(len(y), dtype=bool)
    values, counts = np.unique(y[far], return_counts=True)
    lost = far & (y == values[int(np.argmax(counts))])
    begins = np.count_nonzero(np.diff(np.concatenate([[0], lost.astype(np.int8)])) == 1)
    told = begins >= 2 and np.count_nonzero(lost) >= 0.5 * np.count_nonzero(far)
    return lost if told else np.zeros(len(y), dtype=bool)
