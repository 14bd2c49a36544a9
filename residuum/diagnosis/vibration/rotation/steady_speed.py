"""A vibration as if its shaft had turned evenly, where the record's speed channel says that it did not."""

from __future__ import annotations

import numpy as np

from residuum.array_types import AnyArray
from residuum.diagnosis.vibration.bearings.fault_lines import SLIP
from residuum.diagnosis.vibration.rotation.order_tracking import angle_from_speed, at_even_angle
from residuum.diagnosis.vibration.rotation.shaft_speed import speed_in_rpm
from residuum.identification.errors import BadInput
from residuum.identification.record import Record

_STEADY = 0.005  # speed range [-] below which lines are looked for in time, above in angle
_LONGEST_GAP = 1.0  # s without a reading: the speed of a shaft does little in between that its two neighbours do not tell


def at_steady_speed(
    x: AnyArray, record: Record, name: str | None, said_rpm: float | None = None, *, in_hertz: bool = False
) -> AnyArray:
    """The signal at even steps of shaft angle, as many a turn as it has on average; as it is when the speed is steady.

    Parameters
    ----------
    x : array, shape (n,)
        A channel of `record`, worked on.
    record : Record
        Holds the speed channel.
    name : str or None
        Of the speed channel, if there is one.
    said_rpm : float or None
        The speed that was said apart from the record [rpm].
    in_hertz : bool
        Whether the lines that are looked for are in hertz, and so hold for one speed.

    Raises
    ------
    BadInput
        What was said cannot hold for a shaft that changes its speed, or the speed has gaps of more than a second.
    """
    if name is None:
        return x
    speed = speed_in_rpm(record, name)
    known = speed[np.isfinite(speed)]
    if not known.size or np.ptp(known) <= _STEADY * float(np.median(known)):
        return x
    middle, change = float(np.median(known)), f"channel {name!r} goes from {known.min():.4g} to {known.max():.4g} rpm"
    if in_hertz:
        if np.ptp(known) <= 2 * SLIP * middle:
            return x
        raise BadInput(f"bearing: {change}, but lines in hertz hold for one speed; give orders")
    if said_rpm is not None and abs(said_rpm / middle - 1) > SLIP:
        raise BadInput(f"bearing: speed_rpm is {said_rpm:g}, but {change}; leave speed_rpm out, or that channel")
    turned = angle_from_speed(_bridged(speed, record.sampling_rate), record.sampling_rate)
    return at_even_angle(x, turned, 60 * record.sampling_rate / middle)


def _bridged(speed: AnyArray, rate: float) -> AnyArray:
    """Missing readings on the straight line between their neighbours; those of longer gaps stay missing."""
    known = np.flatnonzero(np.isfinite(speed))
    lengths = np.diff(np.concatenate([[-1], known, [speed.shape[0]]]))
    if lengths.max() > _LONGEST_GAP * rate + 1:
        return speed
    return np.interp(np.arange(speed.shape[0]), known, speed[known])
