"""Is the accelerometer itself sound? A judgement of its own, never a machine fault."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import fft

from residuum.kept_loops import njit

Array = npt.NDArray[Any]
_LEAST_SPAN = 1e-30  # of values; its square still is a number
_AT_RAIL = 8  # samples: fewer at the extreme value are no sign of clipping
_FLAT_SHARE = 0.05  # of the record in one run of equal values
_DRIFT = 3.0  # travel of the mean, in RMS about it
_ONE_WAY = 0.9  # correlation of the mean with time
_SKI_SLOPE = 0.8  # share of the power below 10 Hz
_HUM = 0.6  # share of the power at 50 or 60 Hz and their odd harmonics
_MAINS = (50.0, 60.0)  # Hz
_SAME_GAIN = 0.12  # scatter of ln(gain) over bands: above, something more than a gain changed


def unusable(x: npt.ArrayLike, shortest: int = 128) -> str | None:
    """Why a stretch of acceleration cannot be judged at all, in one sentence; None when it can.

    Too short, a missing sample, silence (all equal), a frozen stretch (one value over 5 % of the time), or clipped.

    >>> unusable(np.zeros(1000))
    'the accelerometer is dead: all 1000 samples are equal to 0'
    """
    x = np.asarray(x)
    n = x.shape[0]
    if n < shortest:
        return f"the window is too short: {n} samples; at least {shortest} are needed"
    if missing := int(np.isnan(x).sum()):
        return f"the window has a gap: {missing} of {n} samples are missing"
    low, high = float(x.min()), float(x.max())
    if low == high:
        return f"the accelerometer is dead: all {n} samples are equal to {low:g}"
    if not _LEAST_SPAN < high - low < 1 / _LEAST_SPAN:
        return f"no accelerometer reads this: all samples lie between {low:g} and {high:g}"
    if (run := _longest_run(x)) > max(_FLAT_SHARE * n, 64):
        return f"the accelerometer froze: {run} samples in a row are equal"
    if (share := clipped_share(x)) > 0:
        return f"the signal is clipped: {100 * share:.2g} % of the samples stand at the range's end {low:g} … {high:g}"
    return None


def suspect(x: npt.ArrayLike, sampling_rate: float, shaft: float | None = None) -> str | None:
    """What points to the sensor, its mounting or its cable rather than the machine; None when nothing does.

    * drift: the mean moves one way by more than 3 RMS of what lies about it (warming sensor, unsettled charge amplifier);
    * loose or overloaded ("ski slope"): more than 80 % of the power below 10 Hz;
    * mains hum: more than 60 % of the power in the lines at 50 or 60 Hz and their odd harmonics (a motor hums at the
      even ones; when the shaft itself turns within 4 % of the mains frequency this is not judged).

    >>> t = np.arange(12000) / 12000
    >>> suspect(np.random.default_rng(0).standard_normal(12000) + 3 * np.cos(2 * np.pi * 50 * t), 12000)
    'mains hum: 82 % of the power lies at 50 Hz and its odd harmonics'
    """
    signal: Array = np.asarray(x, dtype=float)
    return _drift(signal) or _power_elsewhere(signal, sampling_rate, shaft)


def _drift(signal: Array) -> str | None:
    blocks = np.array([block.mean() for block in np.array_split(signal, 16)])
    about = signal - np.repeat(blocks, [block.shape[0] for block in np.array_split(signal, 16)])
    one_way = np.ptp(blocks) > 0 and abs(np.corrcoef(blocks, np.arange(16))[0, 1]) > _ONE_WAY
    if one_way and np.ptp(blocks) > _DRIFT * about.std():
        return (
            f"the sensor drifts: its mean moves by {np.ptp(blocks):.3g} within the window, against {about.std():.3g} of vibration"
        )
    return None


def _power_elsewhere(signal: Array, sampling_rate: float, shaft: float | None) -> str | None:
    """Most of the power below 10 Hz, or in the lines of the mains."""
    n = signal.shape[0]
    power = np.abs(fft.rfft((signal - signal.mean()) * np.hanning(n))) ** 2
    total, df = float(power.sum()), sampling_rate / n
    if df < 5.0 and power[: int(10.0 / df) + 1].sum() > _SKI_SLOPE * total:
        return "the sensor is loose or overloaded: over 80 % of the power lies below 10 Hz"
    for mains in _MAINS:
        if df > mains / 10 or (shaft and abs(shaft / mains - 1) < 0.04):
            continue
        lines = [round(k * mains / df) for k in (1, 3, 5, 7) if k * mains < sampling_rate / 2]
        share = sum(float(power[max(0, line - 2) : line + 3].sum()) for line in lines) / total
        if share > _HUM:
            return f"mains hum: {100 * share:.0f} % of the power lies at {mains:.0f} Hz and its odd harmonics"
    return None


def changed_gain(healthy: npt.ArrayLike, current: npt.ArrayLike) -> float | None:
    """The factor by which a sensor's sensitivity changed, when all bands changed by it and nothing else did; else None.

    `healthy` and `current` are RMS values of the same bands, shape (bands,), at least four. No machine fault raises
    every band by one factor. Below a factor of 1.4 nothing is said.

    >>> changed_gain([1, 2, 3, 4], [10, 20, 30, 40])
    10.0
    >>> changed_gain([1, 2, 3, 4], [1, 2, 3, 40])
    """
    ratio = np.asarray(current, dtype=float) / np.asarray(healthy, dtype=float)
    if not (ratio > 0).all():
        return None
    logs = np.log(ratio)
    middle = float(np.median(logs))
    if logs.shape[0] < 4 or abs(middle) < np.log(1.4) or float(np.abs(logs - middle).max()) > 2 * _SAME_GAIN:
        return None
    return float(round(np.exp(middle), 3))


def clipped_share(x: Array) -> float:
    """Share of the samples at a rail; 0 unless the extreme value holds more samples than the 5 % of range below it.

    The tail of a free signal thins out towards its extreme value; that of a clipped one piles up there.
    """
    return (_piled_up(x) + _piled_up(-x)) / x.shape[0]


def _piled_up(x: Array) -> int:
    """Samples at the upper rail, when they outnumber those of the next 5 % of range (or the next step of a coarse converter)."""
    high, span = float(x.max()), float(np.ptp(x))
    near = x[x >= high - 0.25 * span]
    at_rail = int((near >= high - 1e-6 * span).sum())
    if at_rail < _AT_RAIL:
        return 0
    below = near[near < high - 1e-6 * span]
    width = max(0.05 * span, high - float(below.max())) if below.size else span
    return at_rail if at_rail > int((below >= high - width * (1 + 1e-9)).sum()) else 0


@njit()
def _longest_run(x: Array) -> int:
    longest, run = 1, 1
    for k in range(1, x.shape[0]):
        run = run + 1 if x[k] == x[k - 1] else 1
        longest = max(longest, run)
    return longest
