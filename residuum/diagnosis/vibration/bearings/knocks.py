"""A few knocks are no bearing fault: find them in a stretch of vibration and take them down to the level about them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from residuum.array_types import AnyArray

_FRAME = 0.005  # s
_OFTEN = 4.0  # a second: more is the machine's own doing
_OUTSTANDING = 6.0  # times the energy of the strongest event that is not a knock
_RINGS_DOWN = 2.0  # times the median energy: below, a knock has rung down
_LONGEST = 0.1  # s each side
_USUAL_CREST = 3.0  # of a frame


def without_knocks(x: npt.ArrayLike, sampling_rate: float, slowest: float | None = None) -> tuple[AnyArray, list[float]]:
    r"""The signal with isolated knocks scaled down to the median level of its frames, and their times [s].

    The energy of 5-ms frames, of the signal and of its first difference (so that a rumble hides no click), is divided by
    its median. Of at most 4 events a second, those are knocks that hold more than six times the energy of the strongest
    event left over: a fault that strikes again and again leaves many alike, and keeps them all. Where a fault may
    strike more seldom than that, at most half as many events as it would make are looked at.

    Parameters
    ----------
    x : array, shape (n,), no missing samples; float32 stays float32; not copied when there is no knock
    sampling_rate : float [Hz]
    slowest : float or None
        The lowest rate of impacts [Hz] that must be kept.

    Examples
    --------
    >>> x = np.random.default_rng(0).standard_normal(12000)
    >>> x[6000] += 50.0
    >>> calm, at = without_knocks(x, 12000)
    >>> at, bool(np.abs(calm).max() < 6.0)
    ([0.5], True)
    """
    x = np.asarray(x)
    length = max(8, round(_FRAME * sampling_rate))
    frames = x.shape[0] // length
    seconds = x.shape[0] / sampling_rate
    most = int(max(1.0, min(_OFTEN, 0.5 * slowest if slowest else np.inf) * seconds))
    if frames < 8 * (most + 1):
        return x, []
    energy = _energy(x, length, frames)
    events = _events(energy, most + 1, max(1, round(_LONGEST / _FRAME)))
    if len(events) > most:
        least = _OUTSTANDING * energy[events[-1]].max()
        events = [event for event in events[:-1] if energy[event].max() > least]
    else:
        events = [event for event in events if energy[event].max() > _OUTSTANDING * _RINGS_DOWN]
    if not events:
        return x, []
    mean = x.dtype.type(x.mean(dtype=np.float64))
    parts = x[: frames * length].reshape(frames, length) - mean
    usual = np.sqrt(np.median(np.einsum("ij,ij->i", parts, parts, dtype=np.float64)) / length)
    gain = np.ones(frames)
    for event in events:
        peak = np.abs(parts[event]).max(axis=1) / usual
        gain[event] = 1 / np.maximum(1.0, np.maximum(np.sqrt(energy[event]), peak / _USUAL_CREST))
    gain = np.minimum(gain, np.minimum(np.append(gain[1:], 1.0), np.append(1.0, gain[:-1])))  # edges fall between frames
    at = sorted((event.start + int(energy[event].argmax())) * length / sampling_rate for event in events)
    centres = (np.arange(frames) + 0.5) * length
    return mean + (x - mean) * np.interp(np.arange(x.shape[0]), centres, gain).astype(x.dtype), [round(float(t), 3) for t in at]


def _energy(x: AnyArray, length: int, frames: int) -> AnyArray:
    """The larger of the energies of x and of its first difference a frame, each in its median, shape (frames,)."""
    found = np.zeros(frames)
    for signal in (x - x.mean(dtype=np.float64).astype(x.dtype), np.diff(x, prepend=x[:1])):
        parts = signal[: frames * length].reshape(frames, length)
        energy = np.einsum("ij,ij->i", parts, parts, dtype=np.float64)
        median = float(np.median(energy))
        if not median > 0:
            return np.ones(frames)
        found = np.maximum(found, energy / median)
    return found


def _events(energy: AnyArray, most: int, reach: int) -> list[slice]:
    """The strongest events, strongest first: frames from a peak outwards until it has rung down."""
    left = energy.copy()
    found: list[slice] = []
    while len(found) < most and left.max() > _RINGS_DOWN:
        peak = int(left.argmax())
        calm = energy <= _RINGS_DOWN
        before, after = calm[max(0, peak - reach) : peak][::-1], calm[peak + 1 : peak + 1 + reach]
        start = peak - int(before.argmax() if before.any() else before.size)
        stop = peak + 1 + int(after.argmax() if after.any() else after.size)
        found.append(slice(start, stop))
        left[start:stop] = 0.0
    return found
