"""Noise floor of a channel: how much of a model's error can be measurement noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.residual_analysis.noise.coloured_noise import longest_memory, pole_radius, stretches
from residuum.identification.residual_analysis.policy.noise import (
    ABOVE_A_DRIFT,
    AGREED,
    COLOURS,
    DRIFTS,
    FEWEST_FOR_A_FLOOR,
    LOWEST_FREQUENCY,
    SPECTRUM_SAMPLES,
    STILL_LIKELY,
)


def noise_floor(residuals: Sequence[FloatArray], slowest: float = 1.0, lowest: Sequence[float] = (LOWEST_FREQUENCY,)) -> float:
    """RMS of the noise in a model's error, read from its fast part alone.

    A model's error is slow against the sampling rate, noise is not: an AR(1) spectrum σ²(1 − ρ²)/|1 − ρ e^{−jω}|² is fitted
    (Whittle's likelihood) to the periodogram above 2 % of the sampling rate and σ is given, its slow part included.

    Parameters
    ----------
    residuals : sequence of arrays, shapes (n_r,)
        Measured minus modelled, NaN where missing.
    slowest : float
        Largest ρ that is still called noise.
    lowest : sequence of float
        Where the fast part may begin, in parts of the sampling rate: the least σ is given.

    Returns
    -------
    σ in the channel's unit, at most the RMS of the residuals; 0 for an error without a fast part; the RMS itself for
    fewer than 64 samples in a row.

    Notes
    -----
    Fast errors of the model (ripple, switching) count as noise. For noise slower than ρ ≈ 0.99 it is a lower bound.

    References
    ----------
    P. Whittle, *Estimation and information in stationary time series*, Ark. Mat. 2 (1953).
    """
    parts, rms = _parts_and_rms(residuals)
    if not parts:
        return rms
    length = min(SPECTRUM_SAMPLES, *(len(part) for part in parts))
    spectra = [_spectra(_windows(part, length)).mean(axis=0) for part in parts]
    weights = np.array([len(part) for part in parts], dtype=float)
    power = np.average(spectra, axis=0, weights=weights)
    colours, found = COLOURS[max(slowest, 0.0) >= COLOURS], []
    for begin in lowest:
        frequency, fast = _fast_frequencies(length, begin)
        found.append(_whittle_variance(frequency[fast], power[fast], colours))
    return min(rms, float(np.sqrt(min(found))))


@dataclass(frozen=True)
class Floor:
    """RMS of the noise in an error; `at_most` where the error's own tail may be as large: the noise is then that or less."""

    rms: float
    at_most: bool


def floor_under_drift(residuals: Sequence[FloatArray]) -> Floor:
    """The noise in an error that drifts, steps and lags, told as a size where the spectrum tells it, else as a bound.

    Above 5 % of the sampling rate a structured error is the tail of what it does below: c |1 − e^{−jω}|^{−2} for steps and
    walks, the power −4 for what passed through a machine. Beside it stands AR(1) noise of variance σ². Every pair (ρ, c) gives
    its likeliest σ; all that are nearly as likely as the best are believed. Where they agree within a quarter their middle is
    the noise, otherwise the largest is a bound: the tail of a walk and slow noise are alike.

    Of 144 drawn errors (noise white, coloured, quantised; error none, ramp, sine, drift, steps, lagged steps, lagged noise, walk)
    106 were told as a size, all within 20 %, and none of the bounds was under .9 of the noise.

    Parameters
    ----------
    residuals : sequence of arrays, shapes (n_r,)
        Measured minus modelled, NaN where missing.

    References
    ----------
    P. Whittle, *Estimation and information in stationary time series*, Ark. Mat. 2 (1953).
    """
    parts, rms = _parts_and_rms(residuals)
    if not parts:
        return Floor(rms, at_most=True)
    length = min(SPECTRUM_SAMPLES // 2, *(len(part) for part in parts))
    windows = np.concatenate([_windows(part, length) for part in parts])
    frequency, fast = _fast_frequencies(length, ABOVE_A_DRIFT)
    sizes, cost = _whittle_sizes(frequency[fast], _spectra(windows)[:, fast].mean(axis=0))
    if not sizes.size:
        return Floor(0.0, at_most=False)
    # Hann windows that overlap by half: 1.05 of them count as one, and so do 1.5 of the frequencies
    independent = len(windows) / 1.05 * fast.sum() / 1.5
    believed = np.minimum(sizes[2.0 * independent * (cost - cost.min()) < STILL_LIKELY], rms)
    least, largest = float(believed.min()), float(believed.max())
    return Floor(largest, at_most=True) if largest > AGREED * least else Floor(float(np.sqrt(least * largest)), at_most=False)


def _parts_and_rms(residuals: Sequence[FloatArray]) -> tuple[list[FloatArray], float]:
    """The stretches without a missing sample that are long enough, and the RMS of all samples."""
    every = np.concatenate([residual[np.isfinite(residual)] for residual in residuals])
    rms = float(np.sqrt(np.mean(every**2))) if every.size else 0.0
    return [part for residual in residuals for part in _whole_parts(residual)], rms


def _whittle_sizes(frequency: FloatArray, power: FloatArray) -> tuple[FloatArray, FloatArray]:
    """σ of AR(1) noise beside a power of the frequency, and what its fit costs, of every colour and tail."""
    step = np.abs(1.0 - np.exp(-2j * np.pi * frequency)) ** 2
    sizes, costs = [], []
    for slow in (DRIFTS[:, None] / step, DRIFTS[:, None] / step**2):
        for rho in COLOURS[::2]:
            shape = (1 - rho**2) / np.abs(1 - rho * np.exp(-2j * np.pi * frequency)) ** 2 + slow
            variance = np.mean(power / shape, axis=1) / 2.0
            if np.all(variance > 0):
                sizes.append(np.sqrt(variance))
                costs.append(np.mean(np.log(shape), axis=1) + np.log(variance))
    return (np.concatenate(sizes), np.concatenate(costs)) if sizes else (np.zeros(0), np.zeros(0))


def fast_floor(residuals: Sequence[FloatArray]) -> float:
    """`noise_floor` of noise that is no slower than the residuals can show; 0 if not measured."""
    samples = sum(int(np.isfinite(residual).sum()) for residual in residuals)
    memory = longest_memory(samples, max(map(len, residuals)))
    return noise_floor(residuals, pole_radius(memory)) if samples else 0.0


def times_the_noise(residuals: Sequence[FloatArray]) -> float:
    """RMS of an output's residuals over its `fast_floor`; 0 if not measured."""
    known, floor = np.concatenate([residual[np.isfinite(residual)] for residual in residuals]), fast_floor(residuals)
    return float(np.sqrt(np.mean(known**2))) / floor if floor > 0 else 0.0


def _whole_parts(residual: FloatArray) -> list[FloatArray]:
    return [residual[part] for part in stretches(np.isfinite(residual)) if part.stop - part.start >= FEWEST_FOR_A_FLOOR]


def _windows(part: FloatArray, length: int) -> FloatArray:
    """Stretches of this length, each half over the next; shape (windows, length)."""
    return np.asarray(np.lib.stride_tricks.sliding_window_view(part, length)[:: length - length // 2])


def _spectra(windows: FloatArray) -> FloatArray:
    """One-sided power of each window a unit of relative frequency: its straight line taken out, under a Hann window (Welch)."""
    length = windows.shape[1]
    slope = np.arange(length) - 0.5 * (length - 1)
    line = np.stack([np.full(length, length**-0.5), slope / np.linalg.norm(slope)])
    taper = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(length) / length)
    rest = windows - windows @ line.T @ line
    power = np.abs(np.fft.rfft(rest * taper, axis=1)) ** 2 / np.sum(taper**2)
    power[:, 1 : (length + 1) // 2] *= 2.0
    return np.asarray(power)


def _fast_frequencies(length: int, lowest: float) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Relative frequencies of a window's spectrum, and which of them belong to an error's fast part."""
    frequency = np.asarray(np.fft.rfftfreq(length), dtype=np.float64)
    return frequency, (frequency >= lowest) & (frequency < 0.5)


def _whittle_variance(frequency: FloatArray, power: FloatArray, colours: FloatArray) -> float:
    """Variance of the AR(1) process whose spectrum fits best (one-sided `power` a unit of relative frequency)."""
    shape = (1 - colours[:, None] ** 2) / np.abs(1 - colours[:, None] * np.exp(-2j * np.pi * frequency)) ** 2
    variance = np.mean(power / shape, axis=1) / 2.0
    if not np.all(variance > 0):
        return 0.0
    cost = np.mean(np.log(shape), axis=1) + np.log(variance)
    return float(variance[int(np.argmin(cost))])
