"""Does a vibration itself tell that its shaft changes speed? Lines of its envelope then rise or fall together.

Fault lines are looked for at one speed. Where the speed changes and no channel tells it, they are smeared over many cells of the
spectrum and a broken bearing looks healthy. A short stretch of a changing speed is nearly a linear sweep, which a change of the
time axis undoes: lines that stand out after it, and did not before, belong to a shaft that changes its speed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import fft

from residuum.diagnosis.vibration.envelope import Envelope, envelope_of_spectrum, padded_spectrum

Array = npt.NDArray[Any]
_PERIODS = 80  # of the slowest line a stretch
_MOST_STRETCHES = 3
_AROUND = 1.35
_FASTEST = 0.25  # of the speed, the change within a stretch
_STEP = 1.6  # cells of the fastest line's spectrum by which neighbouring sweeps differ
_STEADY, _MOVES = 1.0, 3.0  # cells over which a line may move to be called steady, and must to be called moving
_NEAR = 0.2  # of a frequency: there no steady line may explain it
_HARMONICS = 3
_PARTS = (1, 2, 4)
_FEWEST_PERIODS = 40
_FLOOR = 48  # lines that share a floor
_STANDS_OUT = 8.0
"""Noise, healthy rigs and steady faults stay below 6.9 or beside a steady line that explains it."""
_MORE_THAN_STEADY = 3.0
_FEWEST_STRETCHES = 3
_CLEAR = 11.0
_DRIFTS, _ON_LINE = 0.02, 0.25  # of the frequency, between the first and the last stretch; of that, beside the straight line


@dataclass(frozen=True)
class MovingLine:
    """A line of the envelope that goes from `first` to `last` [Hz] within `seconds`; `evidence` is its score."""

    first: float
    last: float
    seconds: float
    evidence: float


def moving_line(x: npt.ArrayLike, sampling_rate: float, lines: Mapping[str, float]) -> MovingLine | None:
    r"""The line that moves most clearly within at least half of the stretches, or on from each to the next; None when steady.

    Within a stretch of length L time is replaced by \(t + \rho t (t - L) / (2 L)\), in which a line that changes by the share ρ
    of its frequency is steady. The squared envelope of each band is scored as `fault_lines` does,
    \(\sum_{k=1}^3 \ln(1 + P(kf)/N(kf))\).

    Finds nothing where no line stands out: a healthy bearing on a changing speed is not recognised.

    Parameters
    ----------
    x : array, shape (n,), no missing samples
    sampling_rate : float [Hz]
    lines : mapping of name to expected frequency [Hz]; those around are searched
    """
    signal: Array = np.asarray(x, dtype=np.float32)
    signal = signal - signal.mean()
    slowest, fastest = min(lines.values()) / _AROUND, _AROUND * max(lines.values())
    length = min(signal.shape[0] / sampling_rate, _PERIODS / slowest)
    bands = _bands(sampling_rate, fastest)
    if not bands or length * slowest < _FEWEST_PERIODS:
        return None
    spectrum, padded = padded_spectrum(signal)
    envelopes = [_slow(envelope_of_spectrum(spectrum, padded, signal.shape[0], sampling_rate, *band), fastest) for band in bands]
    rate = envelopes[0][1]
    m = int(length * rate)
    sweeps = _sweeps(fastest * length)
    at = _warped(m, sweeps)
    n = envelopes[0][0].shape[0]
    starts = np.unique(np.linspace(0, n - m, min(_MOST_STRETCHES, max(1, 2 * n // m - 1))).astype(int))
    band = slice(int(slowest * 2 * m / rate), int(fastest * 2 * m / rate) + 1)
    f = np.arange(band.start, band.stop) * rate / (2 * m)
    stretches = [np.max([_scores(values[k : k + m], at) for values, _ in envelopes], axis=0)[:, band] for k in starts]
    swept = [line for scores in stretches if (line := _swept(scores, sweeps, f, length)) is not None]
    if 2 * len(swept) >= len(stretches):
        return max(swept, key=lambda line: line.evidence)
    return _drifted(stretches, f, (starts + m / 2) / rate)


def _bands(rate: float, fastest: float) -> list[tuple[float, float]]:
    """0 … fs/2 in 1, 2 and 4 equal parts, as far as they carry lines up to `fastest`."""
    widths = [(parts, rate / 2 / parts) for parts in _PARTS if rate / 2 / parts >= 2 * fastest]
    return [(k * width, (k + 1) * width) for parts, width in widths for k in range(parts)]


def _slow(envelope: Envelope, fastest: float) -> tuple[Array, float]:
    """The squared envelope of a band over its mean, less one, at a rate that its lines need, and that rate."""
    square, rate = envelope.values**2, envelope.sampling_rate
    n = fft.next_fast_len(max(64, int(square.shape[0] * 2.5 * _HARMONICS * fastest / rate)), real=True)
    n = min(n, square.shape[0])
    transformed = fft.rfft(square / max(float(square.mean()), np.finfo(np.float32).tiny) - 1)
    return fft.irfft(transformed[: n // 2 + 1], n) * (n / square.shape[0]), rate * n / square.shape[0]


def _sweeps(cells: float) -> Array:
    step = _STEP / cells
    count = int(_FASTEST / step)
    return step * np.arange(-count, count + 1)


def _warped(m: int, sweeps: Array) -> Array:
    """Where a stretch of m samples is read so that a line which changes by each share is steady, shape (sweeps, m).

    The phase of such a line is u = t + ρ t (t − L) / (2 L); the instants of even u are wanted, to second order exact at ρ ≤ 1/4.
    """
    u = np.arange(m, dtype=np.float64)
    at = np.stack([np.interp(u, u + rho * u * (u - m) / (2 * m), u) for rho in sweeps])
    return np.clip(at, 0, m - 1.001)


def _scores(values: Array, at: Array) -> Array:
    """Score of every sweep and frequency, shape (sweeps, lines of the spectrum up to a third of its end)."""
    low = at.astype(int)
    part = (at - low).astype(values.dtype)
    read = values[low] * (1 - part) + values[low + 1] * part
    m = at.shape[1]
    spectra = fft.rfft(read * np.hanning(m).astype(read.dtype), 2 * m, axis=1)
    power = spectra.real**2 + spectra.imag**2
    blocks = power.shape[1] // _FLOOR
    floor = np.median(power[:, : blocks * _FLOOR].reshape(power.shape[0], blocks, _FLOOR), axis=2) / np.log(2)
    floor = np.repeat(floor, _FLOOR, axis=1)
    ratio = np.log1p(power[:, : floor.shape[1]] / np.maximum(floor, 1e-30))
    ratio[:, :8] = 0.0
    reach = ratio.shape[1] // _HARMONICS
    return np.asarray(sum(ratio[:, : k * reach : k] for k in range(1, _HARMONICS + 1)))


def _swept(scores: Array, sweeps: Array, f: Array, length: float) -> MovingLine | None:
    """The line that moves within one stretch, and that no steady line near it explains."""
    cells = np.abs(sweeps)[:, None] * f * length
    best = np.unravel_index(np.argmax(np.where(cells >= _MOVES, scores, 0.0)), scores.shape)
    evidence = float(scores[best])
    steady = float(np.where(cells <= _STEADY, scores, 0.0)[:, np.abs(f / f[best[1]] - 1) < _NEAR].max())
    if evidence < _STANDS_OUT or evidence < steady + _MORE_THAN_STEADY:
        return None
    middle, rho = float(f[best[1]]), float(sweeps[best[0]])
    return MovingLine(middle * (1 - rho / 2), middle * (1 + rho / 2), length, evidence)


def _drifted(stretches: list[Array], f: Array, middles: Array) -> MovingLine | None:
    """The line that stands out in every stretch and is further on in each: too slow to be seen within one."""
    at = np.array([float(f[scores.max(axis=0).argmax()]) for scores in stretches])
    evidence = min(float(scores.max()) for scores in stretches)
    change = at[-1] / at[0] - 1
    if len(at) < _FEWEST_STRETCHES or evidence < _CLEAR or abs(change) < _DRIFTS:
        return None
    line = np.interp(middles, middles[[0, -1]], at[[0, -1]])
    if np.abs(at / line - 1).max() > _ON_LINE * abs(change):
        return None
    return MovingLine(float(at[0]), float(at[-1]), float(middles[-1] - middles[0]), evidence)
