"""What three phase currents show of a winding: symmetrical components of the fundamental and its harmonics."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.linalg import lstsq
from scipy.optimize import minimize_scalar

from residuum.identification.errors import BadInput

Matrix = npt.NDArray[np.float64]
Phasors = npt.NDArray[np.complex128]
HARMONICS = (1, 3, 5, 7)
_SEARCH = 0.02  # of the nominal frequency, either side


def supply_frequency(currents: Matrix, sample_time: float, nominal: float) -> float:
    """Frequency [Hz] of the sine that fits all columns best, within 2 % of the nominal one.

    Raises BadInput for fewer than three periods.
    """
    n = currents.shape[0]
    if n * sample_time * nominal < 3:
        raise BadInput(
            f"three-phase currents: {n * sample_time * nominal:.1f} periods of {nominal:g} Hz; at least 3 are needed"
        )
    t = sample_time * np.arange(n, dtype=float)

    def unexplained(frequency: float) -> float:
        return float(lstsq(_basis(t, frequency, (1,)), currents)[1].sum())

    grid = nominal * np.linspace(1 - _SEARCH, 1 + _SEARCH, 41)
    best = int(np.argmin([unexplained(float(f)) for f in grid]))
    low, high = grid[max(best - 1, 0)], grid[min(best + 1, grid.shape[0] - 1)]
    return float(minimize_scalar(unexplained, bounds=(low, high), method="bounded").x)


def harmonic_phasors(
    currents: Matrix, sample_time: float, frequency: float, harmonics: Sequence[int] = HARMONICS
) -> Phasors:
    """Complex amplitude of each harmonic in each phase by least squares, shape (n_harmonics, 3); no leakage between harmonics.

    Parameters
    ----------
    currents : array, shape (n, 3)
        i_a, i_b, i_c [A].
    """
    t = sample_time * np.arange(currents.shape[0], dtype=float)
    theta = lstsq(_basis(t, frequency, harmonics), currents)[0]
    k = len(harmonics)
    return np.asarray(theta[1 : 1 + k] - 1j * theta[1 + k :])


def symmetrical_components(phasors: Phasors) -> Phasors:
    """Zero, positive and negative sequence of phasors (…, 3) of the phases a, b, c (Fortescue 1918), shape (…, 3).

    >>> a = np.exp(2j * np.pi / 3)
    >>> np.round(np.abs(symmetrical_components(np.array([1.0, a**2, a]))), 6).tolist()
    [0.0, 1.0, 0.0]
    """
    a = np.exp(2j * np.pi / 3)
    return np.asarray(phasors @ np.array([[1, 1, 1], [1, a, a**2], [1, a**2, a]]).T / 3)


def current_signature(
    currents: Matrix, sample_time: float, nominal: float, harmonics: Sequence[int] = HARMONICS
) -> Matrix:
    """Sequence currents of all harmonics over the positive-sequence fundamental, real and imaginary parts, and ln of that one.

    A turn short in one phase draws a negative-sequence current whose *angle* to the positive sequence tells the phase and whose
    magnitude tells the share of turns; dividing by the fundamental takes load and moment of sampling away: harmonic k is turned
    back by k times the fundamental's angle. Shape (6 n_harmonics − 1,).
    """
    if currents.ndim != 2 or currents.shape[1] != 3:
        raise BadInput(f"three-phase currents: shape {currents.shape}; must be (n, 3)")
    frequency = supply_frequency(currents, sample_time, nominal)
    sequences = symmetrical_components(
        harmonic_phasors(currents, sample_time, frequency, harmonics)
    )
    first = list(harmonics).index(1)
    # the order of the phases may be a, c, b
    forward = 1 if abs(sequences[first, 1]) >= abs(sequences[first, 2]) else 2
    reference = sequences[first, forward]
    turned = (
        sequences
        * np.exp(-1j * np.angle(reference) * np.asarray(harmonics))[:, None]
        / abs(reference)
    )
    flat = np.delete(turned.ravel(), 3 * first + forward)
    return np.concatenate([flat.real, flat.imag, [np.log(abs(reference))]])


def _basis(t: Matrix, frequency: float, harmonics: Sequence[int]) -> Matrix:
    angle = 2 * np.pi * frequency * np.outer(t, harmonics)
    return np.column_stack([np.ones_like(t), np.cos(angle), np.sin(angle)])
