"""Time-synchronous average: what repeats with every revolution (gears, cams), and what is left (bearings, noise)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy.typing as npt

from residuum.diagnosis.vibration.rotation import at_even_angle
from residuum.identification.errors import BadInput

Array = npt.NDArray[Any]


@dataclass(frozen=True, eq=False)
class SynchronousAverage:
    """Average over revolutions and its scatter.

    Attributes
    ----------
    mean : array, shape (samples a revolution,)
    std : array, same shape
        Standard deviation of one revolution about the mean; that of the mean is smaller by √revolutions.
    revolutions : int
    residual : array, shape (revolutions · samples,)
        Signal at even angle less the mean of each place: noise and everything that is not synchronous.
    """

    mean: Array
    std: Array
    revolutions: int
    residual: Array


def synchronous_average(
    x: npt.ArrayLike, angle: Array, samples_per_revolution: int, revolutions: int = 1
) -> SynchronousAverage:
    """Average a signal over stretches of `revolutions` turns.

    Asynchronous parts fall with the square root of the number of averages. Pass `revolutions` above 1 for a period of several
    turns (hunting tooth). Raises BadInput when the record holds fewer than two periods.

    Parameters
    ----------
    x, angle : arrays, shape (n,)
        Signal and turned revolutions (`order_tracking.angle_from_speed`).
    samples_per_revolution : int
    """
    even = at_even_angle(x, angle, samples_per_revolution)
    period = samples_per_revolution * revolutions
    count = even.shape[0] // period
    if count < 2:
        raise BadInput(
            f"synchronous average: {even.shape[0] / period:.3g} periods; at least 2 are needed"
        )
    table = even[: count * period].reshape(count, period)
    mean = table.mean(axis=0)
    return SynchronousAverage(mean, table.std(axis=0, ddof=1), count, (table - mean).ravel())
