"""What a window's innovations say of every size at once: the sums that all tests and comparisons rest on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.diagnosis.model_based.filtered_window import Filtered
from residuum.identification.errors import NotIdentifiable
from residuum.identification.linear_models.autoregression import fit_autoregression

Array = npt.NDArray[np.float64]

_HIGHEST_ORDER = 12
_PASSES = 2


@dataclass(frozen=True, eq=False)
class WindowStatistics:
    """Sums over the whitened innovations r and their slopes J by every size.

    Attributes
    ----------
    A : array, shape (m, m)
        Jᵀ J.
    g : array, shape (m,)
        Jᵀ r.
    energy, count : array, shape (outputs,)
        Sum of r² and number of readings of each output.
    conditions : array, shape (c,)
        What was recorded beside, in standard deviations of the healthy windows about their mean.
    """

    A: Array
    g: Array
    energy: Array
    count: Array
    conditions: Array

    def scaled(self, sizes: Array) -> WindowStatistics:
        """The sums with the sizes in other units: each is so many of `sizes`."""
        return WindowStatistics(self.A * sizes[:, None] * sizes, self.g * sizes, self.energy, self.count, self.conditions)

    def of(self, columns: Sequence[int] | npt.NDArray[np.int64]) -> WindowStatistics:
        """Those of some sizes alone."""
        at = np.asarray(columns, dtype=np.int64)
        return WindowStatistics(self.A[np.ix_(at, at)], self.g[at], self.energy, self.count, self.conditions)

    def about(self, mean: Array) -> WindowStatistics:
        """The sums with innovations less what sizes of `mean` explain (the energies as they were)."""
        return WindowStatistics(self.A, self.g - self.A @ mean, self.energy, self.count, self.conditions)


@dataclass(frozen=True)
class Colour:
    """Autoregression of one output's normalised innovations, and the standard deviation of what it leaves."""

    polynomial: tuple[float, ...] = (1.0,)
    std: float = 1.0

    def whiten(self, values: Array) -> Array:
        """Values (n, …) through the filter A(q)/σ; where they are missing nothing is added."""
        if len(self.polynomial) == 1:
            return np.asarray(values / self.std)
        found = values / self.std
        for lag, a in enumerate(self.polynomial[1:], start=1):
            found[lag:] += (a / self.std) * values[:-lag]
        return np.asarray(found)


def colours(windows: Sequence[Filtered], J: Sequence[Array], values: Sequence[int], scatter: Array) -> list[Colour]:
    """Colour of each output's innovations over all windows, no product taken across two of them.

    What a window's own values explain is taken away first: the innovations of a window whose resistance is a little higher
    stand off zero, and a colour learned from them would whiten away every lasting change.

    Parameters
    ----------
    J : sequence of array, shape (n, outputs, m)
        Slopes of each window.
    values : sequence of int
        Sizes that may differ from window to window, with the standard deviations `scatter`.
    """
    found = [Colour()] * windows[0].e.shape[1]
    for _ in range(_PASSES):
        rest = []
        for w, slopes in zip(windows, J, strict=True):
            sums = statistics(w, slopes[:, :, list(values)], found).scaled(scatter)
            own = scatter * np.linalg.solve(np.eye(len(scatter)) + sums.A, sums.g)
            rest.append(w.normalised - slopes[:, :, list(values)] @ own)
        found = [_colour(np.concatenate([part for r in rest for part in (r[:, o], [np.nan])])) for o in range(len(found))]
    return found


def _colour(joined: Array) -> Colour:
    try:
        polynomial, variance = fit_autoregression(joined, _HIGHEST_ORDER)
    except NotIdentifiable:
        return Colour()
    return Colour(tuple(polynomial.tolist()), float(np.sqrt(variance)))


def statistics(filtered: Filtered, J: Array, colour: Sequence[Colour], conditions: Array | None = None) -> WindowStatistics:
    """Sums of one window."""
    return sums_of(filtered, whitened(filtered, filtered.normalised, colour), whitened(filtered, J, colour), conditions)


def sums_of(filtered: Filtered, rows: Array, slopes: Array, conditions: Array | None = None) -> WindowStatistics:
    """Sums over whitened innovations and slopes, as `whitened` lays them."""
    there = np.isfinite(filtered.e)
    energy = np.sum(rows.reshape(there.shape[1], -1) ** 2, axis=1)
    beside = np.zeros(0) if conditions is None else conditions
    return WindowStatistics(slopes.T @ slopes, slopes.T @ rows, energy, there.sum(axis=0).astype(float), beside)


def whitened(filtered: Filtered, values: Array, colour: Sequence[Colour]) -> Array:
    """Values (n, outputs, …) whitened output by output and laid one output after the other, shape (n·outputs, …)."""
    parts = []
    for o, white in enumerate(colour):
        there = np.isfinite(filtered.e[:, o])
        kept = there.reshape((-1,) + (1,) * (values.ndim - 2))
        parts.append(np.where(kept, white.whiten(np.where(kept, values[:, o], 0.0)), 0.0))
    return np.concatenate(parts)
