"""Does a vibration itself tell that its shaft changes speed? Lines of its envelope then move.

Fault lines are looked for at one speed. Where the speed changes and no channel tells it, they are smeared over many cells of the
spectrum: a broken bearing looks healthy, or only the slowest lines, which smear least, are left and name the wrong part. A steady
line stands out the more, the longer the stretches are in which it is looked for. A line that moves, at an even rate or to and
fro, is seen in short stretches, where it can be followed from one to the next, and lost in long ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy import fft
from scipy.ndimage import maximum_filter1d

from residuum.array_types import AnyArray
from residuum.diagnosis.vibration.spectra import Envelope, envelope_of_spectrum, padded_spectrum

_PERIODS = (8, 16, 32, 64, 128)  # of the slowest line a stretch
_FEWEST_STRETCHES = 4
_AROUND = 1.35
_HARMONICS = 3
_PARTS = (1, 2, 4)
_PADDED = 2  # times its length a stretch is transformed at: lines lie half a cell apart
_FLOOR = 48  # lines that share a floor
_FASTEST = 2  # lines by which a followed line may move from one stretch to the next, half a stretch later
_MOVES = 2  # lines, at least, between the extremes of one that is called moving
_LEAKS = 8  # lines by which a steady one beyond the searched band may be seen within it in stretches of half the length
_STANDS_OUT = 4.2
"""Mean score of a followed line; noise stays below 3.4, and the busiest healthy rig has steady lines of its own beside it."""
_BESIDE_LONGER, _BESIDE_SAME = 0.5, 1.0
"""By how much a followed line must beat each steady one in stretches of twice the length, or of the same."""


@dataclass(frozen=True)
class MovingLine:
    """A line of the envelope between its two extremes: from `first` to `last` [Hz] within `seconds`; `evidence` is its score."""

    first: float
    last: float
    seconds: float
    evidence: float


@dataclass(frozen=True, eq=False)
class _Followed:
    """What stretches of one length show: scores of the best line that may move and of the best steady one, and the former's way.

    `f` [Hz] is where it is in each stretch, `hop` [s] what lies between two, `moved` the lines between its extremes.
    """

    followed: float
    steady: float
    f: AnyArray
    hop: float
    moved: int

    def beats(self, longer: _Followed | None) -> bool:
        """Whether the line is there, and no steady one stands out as a steady one would."""
        if self.followed < _STANDS_OUT or self.moved < _MOVES:
            return False
        blurred = longer is not None and self.followed >= longer.steady + _BESIDE_LONGER
        return blurred or self.followed >= self.steady + _BESIDE_SAME


def moving_line(x: npt.ArrayLike, sampling_rate: float, lines: Mapping[str, float]) -> MovingLine | None:
    r"""The line that moves most clearly; None where none does.

    In half-overlapping stretches of 8 to 128 periods the squared envelope of each band is scored as `fault_lines` does,
    \(S(f) = \sum_{k=1}^3 \ln(1 + P(kf)/N(kf))\). The line of the largest mean score that moves by at most a cell from stretch to
    stretch (dynamic programming) is held against the best steady line in stretches of the same and of twice the length.

    Finds nothing where no line stands out: a healthy bearing on a changing speed is not recognised, nor is a fault
    whose lines move by many cells within 8 of their periods.

    Parameters
    ----------
    x : array, shape (n,), no missing samples
    sampling_rate : float [Hz]
    lines : mapping of name to expected frequency [Hz]; those around are searched
    """
    signal: AnyArray = np.asarray(x, dtype=np.float32)
    signal = signal - signal.mean()
    slowest, fastest = min(lines.values()) / _AROUND, _AROUND * max(lines.values())
    spectrum, padded = padded_spectrum(signal)
    envelopes = [
        _slow(envelope_of_spectrum(spectrum, padded, signal.shape[0], sampling_rate, *band), fastest)
        for band in _bands(sampling_rate, fastest)
    ]
    looks = [look for periods in _PERIODS if (look := _look(envelopes, periods / slowest, slowest, fastest)) is not None]
    moving = [look for look, longer in pairwise([*looks, None]) if look is not None and look.beats(longer)]
    return _between_extremes(max(moving, key=lambda look: look.followed - look.steady)) if moving else None


def _bands(rate: float, fastest: float) -> list[tuple[float, float]]:
    """0 … fs/2 in 1, 2 and 4 equal parts, as far as they carry lines up to `fastest`."""
    widths = [(parts, rate / 2 / parts) for parts in _PARTS if rate / 2 / parts >= 2 * fastest]
    return [(k * width, (k + 1) * width) for parts, width in widths for k in range(parts)]


def _slow(envelope: Envelope, fastest: float) -> tuple[AnyArray, float]:
    """The squared envelope of a band over its mean, less one, at a rate that its lines need, and that rate."""
    square, rate = envelope.values**2, envelope.sampling_rate
    n = fft.next_fast_len(max(64, int(square.shape[0] * 2.5 * _HARMONICS * fastest / rate)), real=True)
    n = min(n, square.shape[0])
    transformed = fft.rfft(square / max(float(square.mean()), np.finfo(np.float32).tiny) - 1)
    return fft.irfft(transformed[: n // 2 + 1], n) * (n / square.shape[0]), rate * n / square.shape[0]


def _look(envelopes: list[tuple[AnyArray, float]], length: float, slowest: float, fastest: float) -> _Followed | None:
    """The best lines over all bands in stretches of `length` [s]; None where they are too few, or too short for a floor."""
    found = []
    for values, rate in envelopes:
        m = int(length * rate)
        if m < _FLOOR or 2 * values.shape[0] < (_FEWEST_STRETCHES + 1) * m:
            continue
        f_step = rate / (_PADDED * m)
        begin, end = int(slowest / f_step), int(fastest / f_step) + 1
        scores = _scores(values, m)
        followed, way = _follow(scores[:, begin:end])
        around = scores[:, max(0, begin - _LEAKS) : end + _LEAKS]
        steady = float(maximum_filter1d(around, 3, axis=1).mean(axis=0).max())
        found.append(_Followed(followed, steady, (begin + way) * f_step, (m // 2) / rate, int(np.ptp(way))))
    if not found:
        return None
    best = max(found, key=lambda look: look.followed)
    return replace(best, steady=max(look.steady for look in found))


def _scores(values: AnyArray, m: int) -> AnyArray:
    """Score of every stretch of m samples and frequency, shape (stretches, lines of the spectrum up to a third of its end)."""
    starts = np.arange(0, values.shape[0] - m + 1, m // 2)
    stretches = values[starts[:, None] + np.arange(m)] * np.hanning(m).astype(values.dtype)
    spectra = fft.rfft(stretches, _PADDED * m, axis=1)
    power = spectra.real**2 + spectra.imag**2
    blocks = power.shape[1] // _FLOOR
    floor = np.median(power[:, : blocks * _FLOOR].reshape(power.shape[0], blocks, _FLOOR), axis=2) / np.log(2)
    floor = np.repeat(floor, _FLOOR, axis=1)
    ratio = np.log1p(power[:, : floor.shape[1]] / np.maximum(floor, 1e-30))
    ratio[:, : 2 * _PADDED] = 0.0
    reach = ratio.shape[1] // _HARMONICS
    return np.asarray(sum(ratio[:, : k * reach : k] for k in range(1, _HARMONICS + 1)))


def _follow(scores: AnyArray) -> tuple[float, AnyArray]:
    """The largest mean score of a way through the stretches, and that way, shape (stretches,)."""
    count, width = scores.shape
    steps = np.arange(-_FASTEST, _FASTEST + 1)
    came = np.zeros((count, width), dtype=int)
    best = scores[0].astype(np.float64)
    for k in range(1, count):
        beside = np.pad(best, _FASTEST, constant_values=-np.inf)
        reached = np.stack([beside[_FASTEST + step : _FASTEST + step + width] for step in steps])
        chosen = reached.argmax(axis=0)
        came[k] = steps[chosen]
        best = reached[chosen, np.arange(width)] + scores[k]
    way = [int(best.argmax())]
    for k in range(count - 1, 0, -1):
        way.append(way[-1] + int(came[k][way[-1]]))
    return float(best.max() / count), np.array(way[::-1])


def _between_extremes(look: _Followed) -> MovingLine:
    begin, end = sorted((int(look.f.argmin()), int(look.f.argmax())))
    return MovingLine(float(look.f[begin]), float(look.f[end]), (end - begin) * look.hop, look.followed)
