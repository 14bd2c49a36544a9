"""Levenberg–Marquardt search of the prediction error criterion, kept to stable predictors, from
every first value that a structure proposes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.descent import LEAST_DAMPING, End, descend
from residuum.identification.errors import NotIdentifiable
from residuum.identification.linear_models.prediction_error.criterion import (
    Criterion,
    Normal,
    Orders,
)
from residuum.identification.linear_models.prediction_error.data import Signals
from residuum.identification.linear_models.prediction_error.starts import FirstValues, Structure


@dataclass(frozen=True, eq=False)
class Minimum:
    """Where a search ended: parameters, blocks there, whether it converged."""

    x: FloatArray
    normal: Normal
    converged: bool


def minimise(
    criterion: Criterion, start: FloatArray, *, iterations: int = 60, tolerance: float = 1e-9
) -> Minimum:
    """Walk down from `start`; steps that leave the stable region or raise the cost are shortened by
    damping.

    Stops when the predicted relative fall of the cost is below `tolerance`.
    """
    walk = _Walk(criterion, tolerance)
    point, _, end = descend(walk, walk.point(start), steps=iterations)
    return Minimum(point.x, point.normal, converged=end is End.SETTLED)


def best_fit(
    structure: Structure, data: Signals, orders: Orders, first: FirstValues, *, offset: bool
) -> Minimum:
    """The best of the searches from every start; NotIdentifiable when no start has a stable
    predictor.
    """
    criterion = Criterion(data, orders, level=offset)
    minima = [
        minimise(criterion, x, iterations=100) for x in _starts(structure, criterion, orders, first)
    ]
    return min(minima, key=lambda minimum: minimum.normal.cost)


def rough_fit(
    structure: Structure, data: Signals, orders: Orders, first: FirstValues, *, offset: bool
) -> Minimum:
    """A fit that is good enough to compare orders: from the best start, to a cost within 0.01 of
    χ².
    """
    criterion = Criterion(data, orders, level=offset)
    start = min(_starts(structure, criterion, orders, first), key=criterion.cost)
    return minimise(criterion, start, tolerance=0.01 / data.n)


def _starts(
    structure: Structure, criterion: Criterion, orders: Orders, first: FirstValues
) -> list[FloatArray]:
    starts = [criterion.start(theta) for theta in structure.starts(first, orders)]
    usable = [x for x in starts if np.isfinite(criterion.cost(x))]
    if not usable:
        raise NotIdentifiable(
            f"{structure.name} of {orders}: no start has a stable predictor; try a lower order"
        )
    return usable


@dataclass(frozen=True, eq=False)
class _Point:
    x: FloatArray
    normal: Normal

    @property
    def cost(self) -> float:
        return self.normal.cost


class _Walk:
    """The criterion as a landscape; where the predictor is unstable its cost is infinite."""

    def __init__(self, criterion: Criterion, tolerance: float) -> None:
        self.criterion, self.tolerance = criterion, tolerance

    def trial(self, point: _Point, damping: float) -> FloatArray:
        return np.asarray(point.x + _step(point.normal, damping)[0])

    def cost(self, trial: FloatArray) -> float:
        return self.criterion.cost(trial)

    def point(self, trial: FloatArray) -> _Point:
        cost = self.criterion.cost(trial)
        return _Point(
            trial, self.criterion.normal(trial) if np.isfinite(cost) else _nowhere(len(trial))
        )

    def ends(self, point: _Point) -> End | None:
        _, fall = _step(point.normal, LEAST_DAMPING)
        return End.SETTLED if fall <= self.tolerance * point.cost else None


def _nowhere(size: int) -> Normal:
    return Normal(np.inf, np.zeros((size, size)), np.zeros(size), 0)


def _step(normal: Normal, damping: float) -> tuple[FloatArray, float]:
    """(step, fall of the cost that the linear model predicts)."""
    scale = np.sqrt(np.maximum(np.diag(normal.gram), 1e-300))
    scaled = normal.gram / np.outer(scale, scale)
    right = normal.gradient / scale
    step = np.linalg.lstsq(scaled + damping * np.eye(len(right)), right, rcond=1e-14)[0]
    return step / scale, float(2 * step @ right - step @ scaled @ step)
