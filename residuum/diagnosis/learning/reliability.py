"""Are probabilities right? What was said against how often it came true (reliability diagram, as a
table).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.diagnosis.learning.diagnoser_validation import proportion_interval
from residuum.identification.errors import BadInput

# narrow at the ends, where most movements lie
EDGES = (0.0, 0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.98, 1.0)
TENTHS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)


@dataclass(frozen=True)
class ReliabilityLine:
    """One bin of said probabilities [low, high).

    `predicted` is their mean, `observed` the share that came true, `interval` its 95 %
    Clopper–Pearson interval.
    """

    low: float
    high: float
    n: int
    predicted: float
    observed: float
    interval: tuple[float, float]

    @property
    def events(self) -> int:
        """How many came true."""
        return round(self.n * self.observed)

    @property
    def agrees(self) -> bool:
        """Whether the mean that was said lies in the interval of what came true."""
        return self.interval[0] <= self.predicted <= self.interval[1]


def reliability_table(
    predicted: npt.ArrayLike, true: npt.ArrayLike, edges: Sequence[float] = EDGES
) -> list[ReliabilityLine]:
    """One line for each bin that is not empty.

    Parameters
    ----------
    predicted : array, shape (n,)
        Probabilities, of observations that were not trained on: on training data every classifier
        looks calibrated.
    true : array of bool, shape (n,)
    edges : sequence of float
        Increasing, from 0 to 1.

    Raises
    ------
    BadInput
        Unequal lengths, nothing at all, or a number that is no probability.
    """
    p, hit = _checked(predicted, true)
    bins = np.clip(np.searchsorted(np.asarray(edges), p, side="right") - 1, 0, len(edges) - 2)
    lines = []
    for k in np.unique(bins):
        inside = bins == k
        n, events = int(inside.sum()), int(hit[inside].sum())
        interval = proportion_interval(events, n)
        lines.append(
            ReliabilityLine(
                edges[k], edges[k + 1], n, float(p[inside].mean()), events / n, interval
            )
        )
    return lines


def expected_calibration_error(
    predicted: npt.ArrayLike, true: npt.ArrayLike, edges: Sequence[float] = EDGES
) -> float:
    """Mean over the observations of |said − came true| of their bin (Naeini, Cooper and Hauskrecht,
    2015).

    >>> expected_calibration_error([0.2] * 10, [True, True] + [False] * 8)
    0.0
    """
    return calibration_error(reliability_table(predicted, true, edges))


def calibration_error(lines: Sequence[ReliabilityLine]) -> float:
    """The expected calibration error of the bins of a table: Σ n |said − came true| / Σ n."""
    misses = sum(line.n * abs(line.predicted - line.observed) for line in lines)
    return misses / sum(line.n for line in lines)


def _checked(
    predicted: npt.ArrayLike, true: npt.ArrayLike
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
    p, hit = np.asarray(predicted, dtype=float), np.asarray(true, dtype=bool)
    if p.shape != hit.shape or p.ndim != 1 or p.size == 0:
        raise BadInput(
            f"reliability: probabilities of shape {p.shape}, outcomes {hit.shape}; must be (n,)"
            " both, n at least 1"
        )
    if not np.all((p >= 0.0) & (p <= 1.0)):
        raise BadInput(f"reliability: {p[~((p >= 0.0) & (p <= 1.0))][0]!r} is no probability")
    return p, hit
