"""The residual over the gate's way: a damaged rack tooth stays at its place, noise and gusts do not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.identification.errors import BadInput

Signal = npt.NDArray[np.float64]
BINS = 200  # of the whole way: 14 mm of a gate of 2.85 m, about a rack tooth


@dataclass(frozen=True, eq=False)
class PositionProfile:
    """Largest pulse statistic at each place.

    `statistic`, shape (BINS,), in standard deviations, NaN where the gate only ramps; bin 0 is the closed gate, whichever
    way the movement went.
    """

    statistic: Signal

    @property
    def place(self) -> float:
        """Fraction of the way, from the closed gate, where the statistic is largest."""
        return (float(np.nanargmax(self.statistic)) + 0.5) / BINS

    @property
    def contrast(self) -> float:
        """How far the largest bin stands out of the others: (largest − median) / (1.4826 · median absolute deviation)."""
        median = float(np.nanmedian(self.statistic))
        deviation = 1.4826 * float(np.nanmedian(np.abs(self.statistic - median)))
        return (float(np.nanmax(self.statistic)) - median) / max(deviation, np.finfo(float).tiny)


def position_profile(statistic: Signal, position: Signal) -> PositionProfile:
    """Largest |statistic| in each bin of `position` (fraction of the way from the closed gate); both of shape (n,)."""
    profile = np.full(BINS, -np.inf)
    np.maximum.at(profile, np.clip((position * BINS).astype(int), 0, BINS - 1), np.abs(statistic))
    return PositionProfile(np.where(np.isfinite(profile), profile, np.nan))


def average_profile(profiles: Sequence[PositionProfile]) -> PositionProfile:
    """Mean over movements, bin by bin, opening and closing alike.

    What stays at its place keeps its height while the scatter of the rest shrinks with √movements, so the contrast of a
    damage too small for one movement grows. Fails for a gate whose movements start at other places than its ends.

    >>> rng = np.random.default_rng(0)
    >>> way = np.linspace(0, 1, 5000)
    >>> movements = [position_profile(rng.standard_normal(5000) + 2.5 * (abs(way - 0.4) < 0.002), way) for _ in range(12)]
    >>> average = average_profile(movements)
    >>> round(average.place, 2), bool(average.contrast > 2 * np.median([one.contrast for one in movements]))
    (0.4, True)
    """
    if not profiles:
        raise BadInput("average over the way: no movement is given; at least one is needed")
    stacked = np.array([profile.statistic for profile in profiles])
    seen = np.isfinite(stacked)
    total = np.where(seen, stacked, 0.0).sum(axis=0)
    return PositionProfile(np.where(seen.any(axis=0), total / np.maximum(seen.sum(axis=0), 1), np.nan))
