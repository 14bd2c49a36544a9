"""Fits of one structure: the search of the criterion from every first value that the structure
proposes.
"""

from __future__ import annotations

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.errors import NotIdentifiable
from residuum.identification.linear_models.prediction_error.base import Structure
from residuum.identification.linear_models.prediction_error.criterion import Criterion, Orders
from residuum.identification.linear_models.prediction_error.data import Signals
from residuum.identification.linear_models.prediction_error.result import orders_text
from residuum.identification.linear_models.prediction_error.search import Minimum, minimise
from residuum.identification.linear_models.prediction_error.starts import FirstValues


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
            f"{structure.name} of {orders_text(orders)}: no start has a stable predictor; try a"
            " lower order"
        )
    return usable
