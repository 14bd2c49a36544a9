"""A bound on drawn errors over a weight at *every* frequency of an interval, not only at those that were looked at.

Over an interval of half-width h about c a polynomial F(θ) = Σ a_k e^{−j(k−k₀)θ} obeys Taylor's theorem,

    |F(c + t) − F(c) − t F'(c)| ≤ ½ h² Σ (k − k₀)² |a_k|,   |t| ≤ h,

so that |A_i| is bounded from above by the ends of a line, and |B_i| from below by that line's distance from zero. |W| changes
over the arc by the distances to its zeros and poles, which are known exactly. Intervals whose bound is not good enough are
halved (branch and bound).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.array_types import ComplexArray, FloatArray
from residuum.identification.linear_models.error_bounds.drawn_errors import DrawnErrors
from residuum.identification.linear_models.transfer_function import TransferFunction

ABOVE_THE_SEEN = 0.005
"""By how much the bound may lie above the largest value that was seen, in parts."""
_MOST_ROUNDS, _MOST_INTERVALS = 40, 200_000
_VALUES_AT_ONCE = 1_000_000
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Certificate:
    """Where the largest error over the weight lies on a whole band: `seen` ≤ sup_ω max_i |A_i|/|B_i W| ≤ `bound`.

    `proven` tells whether the search ended; otherwise `bound` is infinite, and nothing is promised between the points.
    """

    seen: float
    bound: float
    proven: bool


def largest_excess(errors: DrawnErrors, weight: TransferFunction, omega: npt.ArrayLike) -> Certificate:
    """Bound the largest error over |weight| on the whole band that the grid `omega` [rad/s] spans.

    Parameters
    ----------
    errors : DrawnErrors
    weight : TransferFunction
        Discrete-time, without zeros on the unit circle.
    omega : array
        Increasing; its intervals are where the search begins.
    """
    angle = np.asarray(omega, dtype=float) * errors.sample_time
    left, right = angle[:-1], angle[1:]
    seen, finished = 0.0, 0.0
    for _ in range(_MOST_ROUNDS):
        at_centre, bound = _bounds(errors, weight, left, right)
        seen = max(seen, float(at_centre.max(initial=0.0)))
        enough = bound <= max(1.0, seen) * (1.0 + ABOVE_THE_SEEN)
        finished = max(finished, float(bound[enough].max(initial=0.0)))
        if enough.all():
            return Certificate(seen, finished * (1.0 + _ROUNDING), True)
        left, right = left[~enough], right[~enough]
        if 2 * len(left) > _MOST_INTERVALS:
            break
        middle = 0.5 * (left + right)
        left, right = np.concatenate([left, middle]), np.concatenate([middle, right])
    return Certificate(seen, np.inf, False)


def _bounds(errors: DrawnErrors, weight: TransferFunction, left: FloatArray, right: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Of each interval of angles: the ratio at its centre, and a bound on it within."""
    at_centre, bound = np.empty(len(left)), np.empty(len(left))
    step = max(1, _VALUES_AT_ONCE // len(errors.numerators))
    for first in range(0, len(left), step):
        part = slice(first, first + step)
        centre, half = 0.5 * (left[part] + right[part]), 0.5 * (right[part] - left[part])
        W = np.abs(weight.frequency_response(centre / errors.sample_time))
        least_W = W * _least_change(weight, left[part], right[part], centre)
        highest, above = _above(errors.numerators, centre, half)
        lowest, below = _below(errors.denominators, centre, half)
        with np.errstate(divide="ignore"):
            at_centre[part] = (above / below).max(axis=0) / W
            bound[part] = (highest / np.maximum(lowest, 0.0)).max(axis=0) / least_W
    return at_centre, bound


def _line(rows: FloatArray, centre: FloatArray, half: FloatArray) -> tuple[ComplexArray, ComplexArray, FloatArray]:
    """F(c), h F'(c) and ½ h² Σ (k − k₀)² |a_k| of each row and interval."""
    k = np.arange(rows.shape[1]) - 0.5 * (rows.shape[1] - 1)
    phase = np.multiply.outer(k, centre)
    cosine, sine = np.cos(phase), np.sin(phase)
    turned = rows * k
    value = rows @ cosine - 1j * (rows @ sine)
    slope = -1j * (turned @ cosine) - turned @ sine
    return value, slope * half, np.multiply.outer(np.abs(rows) @ k**2, 0.5 * half**2)


def _above(rows: FloatArray, centre: FloatArray, half: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(bound from above, value at the centre) of |F|."""
    value, change, rest = _line(rows, centre, half)
    ends = np.maximum(np.abs(value + change), np.abs(value - change))  # of a line the ends are furthest from zero
    return ends + rest, np.abs(value)


def _below(rows: FloatArray, centre: FloatArray, half: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(bound from below, value at the centre) of |F|."""
    value, change, rest = _line(rows, centre, half)
    along = (change.conj() * value).real
    nearest = np.clip(-along / np.maximum(np.abs(change) ** 2, 1e-300), -1.0, 1.0)
    return np.abs(value + nearest * change) - rest, np.abs(value)


def _least_change(weight: TransferFunction, left: FloatArray, right: FloatArray, centre: FloatArray) -> FloatArray:
    """Bound from below of |W|/|W(c)| over the arc: each zero's least distance and each pole's largest one, over those from c."""
    least = np.ones(len(centre))
    for root in weight.zeros:
        cosine = np.maximum(np.cos(left - np.angle(root)), np.cos(right - np.angle(root)))
        cosine[(left <= np.angle(root)) & (np.angle(root) <= right)] = 1.0
        least *= _distance(root, cosine) / _distance(root, np.cos(centre - np.angle(root)))
    for root in weight.poles:
        opposite = np.angle(root) + np.pi
        cosine = np.minimum(np.cos(left - np.angle(root)), np.cos(right - np.angle(root)))
        cosine[(left <= opposite) & (opposite <= right)] = -1.0
        least *= _distance(root, np.cos(centre - np.angle(root))) / _distance(root, cosine)
    return least


def _distance(root: complex, cosine: FloatArray) -> FloatArray:
    """|e^{jθ} − r| from the cosine of the angle between them."""
    size = abs(root)
    return np.asarray(np.sqrt(np.maximum((1.0 - size) ** 2 + 2.0 * size * (1.0 - cosine), 1e-300)))
