"""What a window's innovations say of every size at once: the sums that all tests and comparisons rest on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy

from residuum.diagnosis.model_based.filtered_window import Filtered
from residuum.identification.errors import NotIdentifiable
from residuum.identification.linear_models.autoregression import fit_autoregression

Array = npt.NDArray[np.float64]

_HIGHEST_ORDER = 12


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
    """

    A: Array
    g: Array
    energy: Array
    count: Array

    def scaled(self, sizes: Array) -> WindowStatistics:
        """The sums with the sizes in other units: each is so many of `sizes`."""
        return WindowStatistics(self.A * sizes[:, None] * sizes, self.g * sizes, self.energy, self.count)

    def of(self, columns: Sequence[int] | npt.NDArray[np.int64]) -> WindowStatistics:
        """Those of some sizes alone."""
        at = np.asarray(columns, dtype=np.int64)
        return WindowStatistics(self.A[np.ix_(at, at)], self.g[at], self.energy, self.count)

    def about(self, mean: Array) -> WindowStatistics:
        """The sums with innovations less what sizes of `mean` explain (the energies as they were)."""
        return WindowStatistics(self.A, self.g - self.A @ mean, self.energy, self.count)


@dataclass(frozen=True)
class Colour:
    """Autoregression of one output's normalised innovations, and the standard deviation of what it leaves."""

    polynomial: tuple[float, ...] = (1.0,)
    std: float = 1.0

    def whiten(self, values: Array) -> Array:
        """Values (n, …) through the filter A(q)/σ; where they are missing nothing is added."""
        if len(self.polynomial) == 1:
            return np.asarray(values / self.std)
        return np.asarray(scipy.signal.lfilter(self.polynomial, [1.0], values, axis=0) / self.std)


def colours(windows: Sequence[Filtered], sizes: Sequence[Array] | None = None) -> list[Colour]:
    """Colour of each output's innovations over all windows, no product taken across two of them.

    `sizes`: what the causes explain of each window's normalised innovations, to be taken away first.
    """
    outputs = windows[0].e.shape[1]
    rows = [w.normalised - (0.0 if sizes is None else sizes[k]) for k, w in enumerate(windows)]
    found = []
    for o in range(outputs):
        joined = np.concatenate([part for r in rows for part in (r[:, o], [np.nan])])
        try:
            polynomial, variance = fit_autoregression(joined, _HIGHEST_ORDER)
            found.append(Colour(tuple(polynomial.tolist()), float(np.sqrt(variance))))
        except NotIdentifiable:
            found.append(Colour())
    return found


def statistics(filtered: Filtered, J: Array, colour: Sequence[Colour], rows: slice = slice(None)) -> WindowStatistics:
    """Sums of one window (of some of its rows: the innovations are whitened over all of it)."""
    m = J.shape[2]
    A, g = np.zeros((m, m)), np.zeros(m)
    energy, count = np.zeros(J.shape[1]), np.zeros(J.shape[1])
    for o, white in enumerate(colour):
        r = filtered.normalised[:, o]
        there = np.isfinite(r)
        if not there.any():
            continue
        r = np.where(there, white.whiten(np.where(there, r, 0.0)), 0.0)[rows]
        slopes = white.whiten(J[:, o])[rows]
        A += slopes.T @ slopes
        g += slopes.T @ r
        energy[o], count[o] = r @ r, np.count_nonzero(there[rows])
    return WindowStatistics(A, g, energy, count)
