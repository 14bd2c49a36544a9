"""The least value of a function of a few variables, without derivatives."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
_Point = tuple[float, FloatArray]
_SETTLED = 1e-4
"""Extent of the simplex, and difference of its values, at which it stops."""


def nelder_mead(function: Callable[[FloatArray], float], simplex: FloatArray, evaluations: int) -> FloatArray:
    """The best point that so many evaluations find from the corners `simplex`, shape (variables + 1, variables).

    Beside SciPy's, which takes the same steps, it spares a command the import of all its optimisers.

    >>> nelder_mead(lambda x: float((x[0] - 1.0) ** 2 + x[1] ** 2), np.vstack([np.zeros(2), np.eye(2)]), 100).round(3).tolist()
    [1.0, 0.0]

    References
    ----------
    J. A. Nelder, R. Mead, *A simplex method for function minimization*, Comput. J. 7 (1965) 308.
    """
    left = evaluations

    def tried(point: FloatArray) -> _Point:
        nonlocal left
        if left == 0:
            raise _Spent
        left -= 1
        return function(point), point

    points: list[_Point] = []
    with suppress(_Spent):
        points += map(tried, simplex)
        while not _settled(points):
            _move(points, tried)
    return min(points, key=_value)[1]


class _Spent(Exception):
    """No evaluation is left."""


def _value(point: _Point) -> float:
    return point[0]


def _settled(points: list[_Point]) -> bool:
    points.sort(key=_value)
    extent = max(float(np.max(np.abs(x - points[0][1]))) for _, x in points)
    return extent <= _SETTLED and points[-1][0] - points[0][0] <= _SETTLED


def _move(points: list[_Point], tried: Callable[[FloatArray], _Point]) -> None:
    """Reflect, expand or contract the worst of the points, which are sorted; draw all to the best where nothing of it helps."""
    (lowest, best), (second, _), (highest, worst) = points[0], points[-2], points[-1]
    middle = np.add.reduce([x for _, x in points[:-1]]) / (len(points) - 1)

    def beyond(factor: float) -> _Point:
        return tried((1.0 + factor) * middle - factor * worst)

    reflected = beyond(1.0)
    if reflected[0] < lowest:
        expanded = beyond(2.0)
        points[-1] = expanded if expanded[0] < reflected[0] else reflected
        return
    if reflected[0] < second:
        points[-1] = reflected
        return
    outside = reflected[0] < highest
    contracted = beyond(0.5 if outside else -0.5)
    if contracted[0] <= reflected[0] if outside else contracted[0] < highest:
        points[-1] = contracted
        return
    for j, (_, x) in enumerate(points[1:], start=1):
        points[j] = tried(best + 0.5 * (x - best))
