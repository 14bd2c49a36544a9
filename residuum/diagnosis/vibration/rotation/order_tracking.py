"""Order tracking: signals at even steps of shaft angle instead of time, so that speed changes smear no line."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from residuum.array_types import AnyArray
from residuum.identification.errors import BadInput


def angle_from_speed(speed_rpm: npt.ArrayLike, sampling_rate: float) -> AnyArray:
    """Turned revolutions ψ(t)/2π at every sample, shape (n,): the trapezoidal integral of a speed signal [rpm].

    Raises BadInput when the speed has gaps or is not positive throughout (the angle would not be a time axis).
    """
    speed = np.asarray(speed_rpm, dtype=float)
    if not (np.isfinite(speed).all() and (speed > 0).all()):
        raise BadInput("order tracking: the speed has gaps or is not positive throughout")
    steps = (speed[1:] + speed[:-1]) / (2 * 60 * sampling_rate)
    return np.concatenate([[0.0], np.cumsum(steps)])


def at_even_angle(x: npt.ArrayLike, angle: AnyArray, samples_per_revolution: float) -> AnyArray:
    """The signal resampled at even steps of angle by cubic splines.

    With `samples_per_revolution` the mean number that the record has, a line at k times shaft speed, whatever the speed does,
    becomes a sharp line at k orders; a resonance, fixed in hertz, is smeared by the share the speed varies. Components
    above a fifth of the sampling rate lose amplitude (cubic interpolation).

    Examples
    --------
    >>> angle = np.cumsum(np.linspace(0.01, 0.02, 2000))
    >>> x = np.cos(2 * np.pi * 3 * angle)
    >>> y = at_even_angle(x, angle, 60)
    >>> int(np.argmax(np.abs(np.fft.rfft(y[: 60 * 28])))) / 28
    3.0
    """
    x = np.asarray(x)
    if x.shape != angle.shape:
        raise BadInput(f"order tracking: signal {x.shape} and angle {angle.shape} differ in length")
    if not (np.diff(angle) > 0).all():
        raise BadInput("order tracking: the angle does not rise throughout")
    even = np.arange(angle[0], angle[-1], 1.0 / samples_per_revolution)
    at = np.interp(even, angle, np.arange(x.shape[0]))
    return np.asarray(CubicSpline(np.arange(x.shape[0]), x)(at), dtype=x.dtype)
