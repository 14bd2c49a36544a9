"""A frequency grid on which an error envelope hides nothing between its points.

On a fixed grid a resonance or a near zero of the nominal response can lie between two points; a bound that was fitted to the
points then fails there. The envelope is built from responses that are trigonometric polynomials or ratios of them, so what it
does within the angle π/m of the highest lag m is smooth except where the nominal response nearly vanishes. The grid therefore has
points enough for the highest lag, the minima of the nominal response, and then halves each interval whose middle lies above the
line through its ends.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from residuum.array_types import ComplexArray, FloatArray
from residuum.identification.errors import BadInput

Envelope = Callable[[FloatArray], FloatArray]

_DECADES, _LOGARITHMIC = 5.5, 600
_POINTS_A_LAG, _FINE = 4, 30
"""Points of the linear grid, and of the one on which minima of the nominal response are looked for, a lag."""
_MINIMA = 60
OFF_THE_LINE = 0.005
"""By how much a middle may lie above the line through its neighbours, in parts."""
_ROUNDS, _MOST = 12, 6000
_NARROWEST = 1e-6
"""Interval, in parts of its frequency, that is not halved further."""


def refined_grid(
    envelope: Envelope,
    nominal: Callable[[FloatArray], ComplexArray],
    lags: int,
    sample_time: float,
    asked: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Frequencies [rad/s] and the envelope there: between them it lies below the lines through its points, within `OFF_THE_LINE`.

    Parameters
    ----------
    envelope : callable
        ω, shape (k,) → Ω(ω), shape (k,), always of the same random models.
    nominal : callable
        ω → the nominal response.
    lags : int
        Highest power of z in the responses.
    asked : array or None
        Frequencies [rad/s] that the grid has, none below the first; None: 600 over five and a half decades.

    Notes
    -----
    Halving ends after `_ROUNDS` rounds or `_MOST` points; what is left between them is the caller's to check.
    """
    nyquist = math.pi / sample_time
    given = np.geomspace(nyquist / 10**_DECADES, nyquist, _LOGARITHMIC) if asked is None else np.append(asked, nyquist)
    omega = np.unique(
        np.concatenate(
            [
                given,
                nyquist * np.arange(1, _POINTS_A_LAG * lags + 1) / (_POINTS_A_LAG * lags),
                _minima(nominal, lags, nyquist),
            ]
        )
    )
    omega = omega[(omega >= given[0]) & (omega <= nyquist)]
    apart = np.append(True, np.diff(omega) > _NARROWEST * omega[1:])
    omega = omega[apart | np.isin(omega, given)]
    values = envelope(omega)
    doubtful = np.append(np.ones(len(omega) - 1, dtype=bool), False)  # by the point that an interval begins at
    for _ in range(_ROUNDS):
        left = np.flatnonzero(doubtful)
        left = left[omega[left + 1] > omega[left] * (1.0 + _NARROWEST)]
        if not len(left) or len(omega) + len(left) > _MOST:
            break
        middle = np.sqrt(np.maximum(omega[left], 0.1 * omega[left + 1]) * omega[left + 1])  # from ω = 0: a tenth
        seen = envelope(middle)
        line = np.sqrt(values[left] * values[left + 1])  # the middle of a straight line in (ln ω, ln Ω)
        doubtful[left] = above = seen > line * (1.0 + OFF_THE_LINE)
        order = np.argsort(np.concatenate([omega, middle]))
        omega, values, doubtful = (np.concatenate(pair)[order] for pair in ((omega, middle), (values, seen), (doubtful, above)))
    return omega, values


def _minima(nominal: Callable[[FloatArray], ComplexArray], lags: int, nyquist: float) -> FloatArray:
    """Where the nominal response is smallest beside its neighbours, found on a fine grid and by parabolas through it."""
    omega = nyquist * np.arange(1, _FINE * lags + 1) / (_FINE * lags)
    power = np.abs(nominal(omega)) ** 2
    inner = np.flatnonzero((power[1:-1] < power[:-2]) & (power[1:-1] <= power[2:])) + 1
    inner = inner[np.argsort(power[inner])[:_MINIMA]]
    step = omega[1] - omega[0]
    bend = power[inner - 1] - 2 * power[inner] + power[inner + 1]
    shift = 0.5 * np.divide(power[inner - 1] - power[inner + 1], bend, out=np.zeros(len(inner)), where=bend > 0)
    return np.asarray(omega[inner] + step * np.clip(shift, -0.5, 0.5))


def asked_grid(sample_time: float, points: int | None, lowest: float | None) -> FloatArray | None:
    """The logarithmic grid [rad/s] up to π/Ts of so many points from a lowest frequency on; None: neither was asked for.

    Raises BadInput when the lowest frequency does not lie between 0 and π/Ts.
    """
    if points is None and lowest is None:
        return None
    nyquist = np.pi / sample_time
    low = nyquist / 10**_DECADES if lowest is None else lowest
    if not 0 < low < nyquist:
        raise BadInput(f"lowest frequency {low:g}: must lie between 0 and the Nyquist frequency, {nyquist:.6g} rad/s")
    return np.asarray(np.geomspace(low, nyquist, points or _LOGARITHMIC))
