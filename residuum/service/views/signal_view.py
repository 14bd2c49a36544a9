"""What a page shows of a long signal: minimum and maximum an interval.

Every `interval` keeps its extremes, so a peak of one sample survives any reduction; picking one sample an interval
(largest-triangle and the like) can lose it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray


@dataclass(frozen=True, eq=False)
class Extremes:
    """Minimum and maximum of every `samples` samples, shapes (intervals,); NaN where an interval has no sample."""

    samples: int
    minimum: FloatArray
    maximum: FloatArray


def extremes(signal: npt.NDArray[Any], most: int) -> Extremes:
    """Reduce a signal of n samples to at most `most` intervals of equal length (the last may be shorter).

    Missing samples (NaN) are passed over; an interval of nothing else is NaN.

    >>> extremes(np.array([0.0, 5.0, -1.0, 2.0, np.nan]), 3).maximum.tolist()
    [5.0, 2.0, nan]
    """
    n = signal.shape[0]
    samples = max(1, -(-n // most))
    whole = n // samples
    body = signal[: whole * samples].reshape(whole, samples)
    lowest, highest = np.fmin.reduce(body, axis=1), np.fmax.reduce(body, axis=1)
    if rest := n - whole * samples:
        lowest = np.append(lowest, np.fmin.reduce(signal[-rest:]))
        highest = np.append(highest, np.fmax.reduce(signal[-rest:]))
    return Extremes(samples, lowest.astype(np.float64), highest.astype(np.float64))


def extremes_of_pieces(pieces: Iterator[npt.NDArray[Any]], n: int, most: int) -> Extremes:
    """`extremes` of a signal of n samples that comes piece by piece.

    >>> extremes_of_pieces(iter([np.array([0.0, 5.0, -1.0]), np.array([2.0, np.nan])]), 5, 3).maximum.tolist()
    [5.0, 2.0, nan]
    """
    samples = max(1, -(-n // most))
    found, held = list[Extremes](), np.empty(0)
    for piece in pieces:
        held = np.concatenate([held, piece]) if len(held) else piece
        if whole := len(held) // samples:
            found.append(extremes(held[: whole * samples], whole))
            held = held[whole * samples :]
    if len(held):
        found.append(extremes(held, 1))
    return Extremes(samples, *(np.concatenate([getattr(each, end) for each in found]) for end in ("minimum", "maximum")))


def stretch(pieces: Iterator[npt.NDArray[Any]], first: int, last: int) -> Iterator[npt.NDArray[Any]]:
    """The samples first … last − 1 of a signal that comes piece by piece; it is taken to its end, where damage shows."""
    begin = 0
    for piece in pieces:
        if len(here := piece[max(0, first - begin) : max(0, last - begin)]):
            yield here
        begin += len(piece)
