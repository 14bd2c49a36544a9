"""Pareto front of two wishes when asking less of the second one always stays feasible."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

Design = TypeVar("Design")


@dataclass(frozen=True)
class Point(Generic[Design]):
    """A feasible pair on the front, with the design that meets it."""

    first: float
    second: float
    design: Design


def bisected_front(
    firsts: Sequence[float],
    seconds: Sequence[float],
    meets: Callable[[float, float, Design | None], Design | None],
) -> list[Point[Design]]:
    """The front over a grid of two wishes, each ordered from modest to ambitious.

    For each value of the first wish the most ambitious second one is found by bisection, about log₂(len(seconds)) designs;
    dominated points are then left out. `meets(first, second, warm)` gives a design or None; `warm` is a design that
    met a neighbouring pair.

    >>> found = bisected_front([1, 2, 3], [1, 2, 3, 4], lambda a, b, _: (a, b) if a * b <= 4 else None)
    >>> [(point.first, point.second) for point in found]
    [(1, 4), (2, 2), (3, 1)]
    """
    found: list[tuple[int, Point[Design]]] = []
    warm: Design | None = None
    for first in firsts:
        low, high = 0, len(seconds) - 1
        best: tuple[int, Design] | None = None
        while low <= high:
            middle = (low + high) // 2
            design = meets(first, seconds[middle], warm)
            if design is None:
                high = middle - 1
            else:
                best, warm = (middle, design), design
                low = middle + 1
        if best is not None:
            found.append((best[0], Point(first, seconds[best[0]], best[1])))
    return [point for k, (rank, point) in enumerate(found) if all(later < rank for later, _ in found[k + 1 :])]


def preferred(
    front: Sequence[Point[Design]], ideal: tuple[float, float], span: tuple[float, float], only: int | None
) -> Point[Design]:
    """The nearest point, or the best in one wish alone and, among equals, in the other: the single-objective form of Remark 2.7.

    Parameters
    ----------
    only : int or None
        0 or 1: the wish that counts; None: both.
    """
    if only is None:
        return closest(front, ideal, span)
    values = [(point.first, point.second) for point in front]
    distances = [tuple(abs(value[k] - ideal[k]) / span[k] for k in (only, 1 - only)) for value in values]
    return front[min(range(len(front)), key=distances.__getitem__)]


def closest(front: Sequence[Point[Design]], ideal: tuple[float, float], span: tuple[float, float]) -> Point[Design]:
    """The point nearest to the ideal pair, each wish measured in its span."""
    distances = [np.hypot((p.first - ideal[0]) / span[0], (p.second - ideal[1]) / span[1]) for p in front]
    return front[int(np.argmin(distances))]
