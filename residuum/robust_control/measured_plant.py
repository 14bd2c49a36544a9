"""A plant that is known only by its measured frequency response, and the stability of its loop by Nyquist's criterion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.array_types import ComplexArray, FloatArray
from residuum.identification.errors import BadInput

_LONGEST_TURN = 0.5 * np.pi
_FURTHEST_FROM_AXIS = np.pi / 4


@dataclass(frozen=True, eq=False)
class MeasuredPlant:
    """G(e^{jωTs}) at measured frequencies, taken as it is.

    Parameters
    ----------
    omega : array, shape (k,)
        [rad/s], increasing, within (0, π/Ts].
    response : array, shape (k,)
    sample_time : float
        [s]
    unstable_poles, integrators : int
        Poles of the plant outside the unit circle, and at z = 1; data alone do not tell them.

    Raises
    ------
    BadInput
        Shapes differ, values are not finite, frequencies do not increase within (0, π/Ts], counts are negative.
    """

    omega: FloatArray
    response: ComplexArray
    sample_time: float
    unstable_poles: int = 0
    integrators: int = 0

    def __post_init__(self) -> None:
        omega, response = np.asarray(self.omega, dtype=float), np.asarray(self.response, dtype=complex)
        if omega.ndim != 1 or len(omega) < 2 or response.shape != omega.shape:
            raise BadInput(f"MeasuredPlant: {omega.shape} frequencies and {response.shape} values; needs two or more of each")
        if not (np.isfinite(omega).all() and np.isfinite(response).all()):
            raise BadInput("MeasuredPlant: a frequency or a value is not finite")
        if not self.sample_time > 0:
            raise BadInput(f"MeasuredPlant, sample_time: is {self.sample_time!r}; must be positive")
        if omega[0] <= 0 or np.any(np.diff(omega) <= 0) or omega[-1] > np.pi / self.sample_time * (1 + 1e-9):
            raise BadInput(f"MeasuredPlant, omega: must increase within 0 … π/Ts = {np.pi / self.sample_time:.6g} rad/s")
        if min(self.unstable_poles, self.integrators) < 0:
            raise BadInput("MeasuredPlant: numbers of poles must not be negative")
        object.__setattr__(self, "omega", omega)
        object.__setattr__(self, "response", response)

    def frequency_response(self, omega: npt.ArrayLike) -> ComplexArray:
        """Values between the measured ones, linear in ln ω; none outside them (BadInput)."""
        omega = np.asarray(omega, dtype=float)
        if np.any(omega < self.omega[0] * (1 - 1e-9)) or np.any(omega > self.omega[-1] * (1 + 1e-9)):
            raise BadInput(f"MeasuredPlant: measured from {self.omega[0]:.6g} to {self.omega[-1]:.6g} rad/s only")
        at, known = np.log(omega), np.log(self.omega)
        return np.interp(at, known, self.response.real) + 1j * np.interp(at, known, self.response.imag)


def closed_loop_unstable_poles(L: ComplexArray, unstable_poles: int, integrators: int) -> int | None:
    """Poles of the closed loop outside the unit circle, from the turns of 1 + L about zero; None when the data do not tell.

    With the path past z = 1 on its outside, 1 + L turns P − Z times about zero as z goes once round the unit circle: Z and
    P are the poles of the closed and of the open loop outside. Half the path is measured; each integrator adds −½ turn at z = 1.

    Parameters
    ----------
    L : array, shape (k,)
        Open loop on increasing frequencies from well below the loop's bandwidth to (near) the Nyquist frequency.
    unstable_poles, integrators : int
        Of the open loop: outside the circle, and at z = 1.

    Notes
    -----
    None when 1 + L turns by more than 90° from one frequency to the next (the grid is too coarse to count), or is more than 45°
    from its asymptote at the ends (the grid ends too early). A resonance that stands between two frequencies cannot be seen.

    Examples
    --------
    >>> z = np.exp(1j * np.geomspace(1e-3, np.pi, 400))
    >>> [closed_loop_unstable_poles(gain / (z - 1.0), 0, 1) for gain in (0.5, 3.0)]
    [0, 1]
    """
    distance = 1.0 + L
    if not np.all(np.abs(distance) > 0):
        return None
    turns = np.angle(distance[1:] / distance[:-1])
    if np.abs(turns).max() > _LONGEST_TURN:
        return None
    # to the axis of the integrators' asymptote below the first frequency, to the real axis above the last one
    before = _from_axis(np.angle(distance[0]) + 0.5 * np.pi * integrators)
    after = _from_axis(np.angle(distance[-1]))
    if max(abs(before), abs(after)) > _FURTHEST_FROM_AXIS:
        return None
    winding = (turns.sum() + before - after) / np.pi - 0.5 * integrators
    outside = int(np.round(unstable_poles - winding))
    return outside if outside >= 0 else None


def _from_axis(angle: float) -> float:
    """The angle from the nearest multiple of 180°."""
    return float(angle - np.pi * np.round(angle / np.pi))
