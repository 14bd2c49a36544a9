"""Vibration severity in zones A–D: broadband velocity RMS from acceleration, against the limits of a machine class."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import numpy.typing as npt
from scipy import fft

from residuum.array_types import AnyArray
from residuum.identification.errors import BadInput
from residuum.nearest_names import known_names

# Upper limits of zones A, B, C [mm/s RMS]. Classes I–IV: small, medium, large on rigid, large on soft foundations;
# groups 1 and 2: large and medium industrial machines.
LIMITS = MappingProxyType(
    {
        "I": (0.71, 1.8, 4.5),
        "II": (1.12, 2.8, 7.1),
        "III": (1.8, 4.5, 11.2),
        "IV": (2.8, 7.1, 18.0),
        "group-1-rigid": (2.3, 4.5, 7.1),
        "group-1-flexible": (3.5, 7.1, 11.0),
        "group-2-rigid": (1.4, 2.8, 4.5),
        "group-2-flexible": (2.3, 4.5, 7.1),
    }
)


@dataclass(frozen=True)
class Severity:
    """Velocity RMS [mm/s], zone (A new, B unrestricted, C limited, D damaging) and the limits of A, B, C [mm/s]."""

    velocity: float
    zone: str
    limits: tuple[float, float, float]


def severity(acceleration: npt.ArrayLike, sampling_rate: float, machine_class: str) -> Severity:
    """Zone of a record of acceleration [m/s²].

    Raises BadInput for an unknown class or a record that cannot hold 10 … 1000 Hz.

    Examples
    --------
    10 mm/s of amplitude at 50 Hz is 7.07 mm/s RMS:

    >>> t = np.arange(10000) / 5000
    >>> found = severity(2 * np.pi * 50 * 0.010 * np.cos(2 * np.pi * 50 * t), 5000, "II")
    >>> round(found.velocity, 2), found.zone
    (7.07, 'C')
    """
    if machine_class not in LIMITS:
        raise BadInput(f"severity: machine class {machine_class!r} is not known; {known_names(machine_class, LIMITS)}")
    velocity = 1000 * velocity_rms(acceleration, sampling_rate)
    limits = LIMITS[machine_class]
    return Severity(velocity, "ABCD"[int(np.searchsorted(limits, velocity))], limits)


def velocity_rms(acceleration: npt.ArrayLike, sampling_rate: float, low: float = 10.0, high: float = 1000.0) -> float:
    """RMS of velocity [m/s] between low and high [Hz]: each line of the spectrum divided by its 2πf (Parseval).

    The Hann window keeps what lies below `low` from leaking in, where 1/f would magnify it.
    """
    a: AnyArray = np.asarray(acceleration, dtype=float)
    if sampling_rate < 2 * high or a.shape[0] < 4 * sampling_rate / low:
        raise BadInput(
            f"severity: {a.shape[0]} samples of {sampling_rate:g} Hz; {low:g} … {high:g} Hz need {2 * high:g} Hz, {4 / low:g} s"
        )
    window = np.hanning(a.shape[0])
    padded = fft.next_fast_len(a.shape[0], real=True)
    f = fft.rfftfreq(padded, 1 / sampling_rate)
    inside = (f >= low) & (f <= high)
    power = np.abs(fft.rfft((a - a.mean()) * window, padded)[inside] / (2 * np.pi * f[inside])) ** 2
    return float(np.sqrt(2 * power.sum() / (padded * np.sum(window**2))))
