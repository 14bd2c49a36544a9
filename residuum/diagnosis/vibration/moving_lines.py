"""Does a vibration itself tell that its shaft changes speed? Lines of its envelope then move.

Fault lines are looked for at one speed. Where the speed changes and no channel tells it, they are
smeared over many cells of the spectrum: a broken bearing looks healthy, or only the slowest lines,
which smear least, are left and name the wrong part. A steady line stands out the more, the longer
the stretches are in which it is looked for. A line that moves, at an even rate or to and fro, is
seen in short stretches, where it can be followed from one to the next, and lost in long ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy import fft
from scipy.ndimage import maximum_filter1d

from residuum.array_types import AnyArray
from residuum.diagnosis.vibration.spectra import Envelope, PaddedSpectrum

# A few knocks are no bearing fault: find them in a stretch of vibration and take them down to the
# level about them.

_FRAME = 0.005  # s
_OFTEN = 4.0  # a second: more is the machine's own doing
_OUTSTANDING = 6.0  # times the energy of the strongest event that is not a knock
_RINGS_DOWN = 2.0  # times the median energy: below, a knock has rung down
_LONGEST = 0.1  # s each side
_USUAL_CREST = 3.0  # of a frame


def without_knocks(
    x: npt.ArrayLike, sampling_rate: float, slowest: float | None = None
) -> tuple[AnyArray, list[float]]:
    r"""The signal with isolated knocks scaled down to the median level of its frames, and their
    times [s].

    The energy of 5-ms frames, of the signal and of its first difference (so that a rumble hides no
    click), is divided by its median. Of at most 4 events a second, those are knocks that hold more
    than six times the energy of the strongest event left over: a fault that strikes again and again
    leaves many alike, and keeps them all. Where a fault may strike more seldom than that, at most
    half as many events as it would make are looked at.

    Parameters
    ----------
    x : array, shape (n,), no missing samples
        float32 stays float32; not copied when there is no knock.
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
    # edges fall between frames
    gain = np.minimum(gain, np.minimum(np.append(gain[1:], 1.0), np.append(1.0, gain[:-1])))
    at = sorted(
        (event.start + int(energy[event].argmax())) * length / sampling_rate for event in events
    )
    centres = (np.arange(frames) + 0.5) * length
    return mean + (x - mean) * np.interp(np.arange(x.shape[0]), centres, gain).astype(x.dtype), [
        round(float(t), 3) for t in at
    ]


def _energy(x: AnyArray, length: int, frames: int) -> AnyArray:
    """The larger of the energies of x and of its first difference a frame, each in its median,
    shape (frames,).
    """
    largest = np.zeros(frames)
    for signal in (x - x.mean(dtype=np.float64).astype(x.dtype), np.diff(x, prepend=x[:1])):
        parts = signal[: frames * length].reshape(frames, length)
        energy = np.einsum("ij,ij->i", parts, parts, dtype=np.float64)
        median = float(np.median(energy))
        if not median > 0:
            return np.ones(frames)
        largest = np.maximum(largest, energy / median)
    return largest


def _events(energy: AnyArray, most: int, reach: int) -> list[slice]:
    """The strongest events, strongest first: frames from a peak outwards until it has rung down."""
    left = energy.copy()
    events: list[slice] = []
    while len(events) < most and left.max() > _RINGS_DOWN:
        peak = int(left.argmax())
        calm = energy <= _RINGS_DOWN
        before, after = calm[max(0, peak - reach) : peak][::-1], calm[peak + 1 : peak + 1 + reach]
        start = peak - int(before.argmax() if before.any() else before.size)
        stop = peak + 1 + int(after.argmax() if after.any() else after.size)
        events.append(slice(start, stop))
        left[start:stop] = 0.0
    return events


# Vibration of a bearing with a localised fault, by formula: the signal that envelope analysis
# assumes.


def impact_train(
    n: int,
    sampling_rate: float,
    frequency: float,
    *,
    resonance: float,
    damping: float = 0.05,
    slip: float = 0.01,
    modulation: float = 0.0,
    modulated_at: float = 0.0,
    seed: int = 0,
) -> AnyArray:
    r"""Impacts of a passing fault that ring a resonance, unit RMS.

    .. math::
        x(t) = \sum_i (1 + m \cos 2\pi f_m t_i)(1 + 0.1 \epsilon_i) h(t - t_i), \quad t_{i+1} = t_i
        + (1 + s \eta_i)/f, \quad h(t) = e^{-2\pi\zeta f_n t} \sin 2\pi f_n t

    Parameters
    ----------
    n, sampling_rate : samples, [Hz]
    frequency : f, mean rate of the impacts [Hz]
    resonance, damping : f_n [Hz] and ζ [-]
    slip : s, random part of each interval [-] (it accumulates, so high harmonics smear)
    modulation, modulated_at : m [-] and f_m [Hz]
        A load zone modulates an inner race with the shaft, a ball with the cage.
    seed : of the random ε, η

    References
    ----------
    J. Antoni, R. B. Randall, J. Vib. Acoust. 125 (2003) 282–289.
    """
    rng = np.random.default_rng(seed)
    count = int(n / sampling_rate * frequency * (1 + 5 * slip)) + 8
    times = np.cumsum((1 + slip * rng.standard_normal(count)) / frequency)
    at = (times * sampling_rate).astype(int)
    strength = (1 + modulation * np.cos(2 * np.pi * modulated_at * times)) * (
        1 + 0.1 * rng.standard_normal(count)
    )
    impacts = np.zeros(n)
    np.add.at(impacts, at[at < n], strength[at < n])
    t = (
        np.arange(min(n, int(8 * sampling_rate / (2 * np.pi * damping * resonance)) + 2))
        / sampling_rate
    )
    ring = np.exp(-2 * np.pi * damping * resonance * t) * np.sin(2 * np.pi * resonance * t)
    x = np.fft.irfft(np.fft.rfft(impacts, 2 * n) * np.fft.rfft(ring, 2 * n), 2 * n)[:n]
    return np.asarray(x / np.sqrt(np.mean(x * x)))


def faulty_bearing(
    n: int,
    sampling_rate: float,
    shaft: float,
    orders: dict[str, float],
    fault: Literal["bpfi", "bpfo", "bsf", "ftf"] | None,
    *,
    snr_db: float = 0.0,
    resonance: float = 3200.0,
    seed: int = 0,
) -> AnyArray:
    """White noise of unit RMS, shaft harmonics, and (unless `fault` is None) the fault's impacts
    `snr_db` above the noise.
    """
    rng = np.random.default_rng([seed, 1])
    t = np.arange(n) / sampling_rate
    x = rng.standard_normal(n)
    for harmonic in (1, 2, 3):
        x += 0.3 / harmonic * np.cos(2 * np.pi * harmonic * shaft * t + rng.uniform(0, 2 * np.pi))
    if fault is None:
        return np.asarray(x)
    rate, modulation, modulated_at = {
        "bpfi": (orders.get("bpfi", 0.0), 0.8, shaft),
        "bpfo": (orders.get("bpfo", 0.0), 0.0, 0.0),
        "bsf": (2 * orders.get("bsf", 0.0), 0.5, orders.get("ftf", 0.4) * shaft),
        "ftf": (orders.get("ftf", 0.0), 0.0, 0.0),
    }[fault]
    train = impact_train(
        n,
        sampling_rate,
        rate * shaft,
        resonance=resonance,
        modulation=modulation,
        modulated_at=modulated_at,
        seed=seed,
    )
    return np.asarray(x + 10 ** (snr_db / 20) * train)


_PERIODS = (8, 16, 32, 64, 128)  # of the slowest line a stretch
_FEWEST_STRETCHES = 4
_AROUND = 1.35
_HARMONICS = 3
_PARTS = (1, 2, 4)
_PADDED = 2  # times its length a stretch is transformed at: lines lie half a cell apart
_FLOOR = 48  # lines that share a floor
_FASTEST = (
    2  # lines by which a followed line may move from one stretch to the next, half a stretch later
)
_MOVES = 2  # lines, at least, between the extremes of one that is called moving
# lines by which a steady one beyond the searched band may be seen within it in stretches of half
# the length
_LEAKS = 8
_STANDS_OUT = 4.2
"""Mean score of a followed line; noise stays below 3.4, and the busiest healthy rig has steady
lines of its own beside it.
"""
_BESIDE_LONGER, _BESIDE_SAME = 0.5, 1.0
"""By how much a followed line must beat each steady one in stretches of twice the length, or of the
same.
"""


@dataclass(frozen=True)
class MovingLine:
    """A line of the envelope between its two extremes: from `first` to `last` [Hz] within
    `seconds`; `evidence` is its score.
    """

    first: float
    last: float
    seconds: float
    evidence: float


@dataclass(frozen=True, eq=False)
class _Followed:
    """What stretches of one length show: scores of the best line that may move and of the best
    steady one, and the former's way.

    `f` [Hz] is where it is in each stretch, `hop` [s] what lies between two, `moved` the lines
    between its extremes.
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


def moving_line(
    x: npt.ArrayLike, sampling_rate: float, lines: Mapping[str, float]
) -> MovingLine | None:
    r"""The line that moves most clearly; None where none does.

    In half-overlapping stretches of 8 to 128 periods the squared envelope of each band is scored as
    `bearing_lines` does, \(S(f) = \sum_{k=1}^3 \ln(1 + P(kf)/N(kf))\). The line of the largest mean
    score that moves by at most a cell from stretch to stretch (dynamic programming) is held against
    the best steady line in stretches of the same and of twice the length.

    Finds nothing where no line stands out: a healthy bearing on a changing speed is not recognised,
    nor is a fault whose lines move by many cells within 8 of their periods.

    Parameters
    ----------
    x : array, shape (n,), no missing samples
    sampling_rate : float [Hz]
    lines : mapping of name to expected frequency [Hz]; those around are searched
    """
    signal: AnyArray = np.asarray(x, dtype=np.float32)
    signal = signal - signal.mean()
    slowest, fastest = min(lines.values()) / _AROUND, _AROUND * max(lines.values())
    spectrum = PaddedSpectrum.of(signal, sampling_rate)
    bands = _bands(sampling_rate, fastest)
    envelopes = [_slow(spectrum.envelope(low, high), fastest) for low, high in bands]
    looks = [_look(envelopes, periods / slowest, slowest, fastest) for periods in _PERIODS]
    long_enough = [look for look in looks if look is not None]
    moving = [
        look for look, longer in zip_longest(long_enough, long_enough[1:]) if look.beats(longer)
    ]
    if not moving:
        return None
    return _between_extremes(max(moving, key=lambda look: look.followed - look.steady))


def _bands(rate: float, fastest: float) -> list[tuple[float, float]]:
    """0 … fs/2 in 1, 2 and 4 equal parts, as far as they carry lines up to `fastest`."""
    widths = [(parts, rate / 2 / parts) for parts in _PARTS if rate / 2 / parts >= 2 * fastest]
    return [(k * width, (k + 1) * width) for parts, width in widths for k in range(parts)]


def _slow(envelope: Envelope, fastest: float) -> tuple[AnyArray, float]:
    """The squared envelope of a band over its mean, less one, at a rate that its lines need, and
    that rate.
    """
    square, rate = envelope.values**2, envelope.sampling_rate
    n = fft.next_fast_len(
        max(64, int(square.shape[0] * 2.5 * _HARMONICS * fastest / rate)), real=True
    )
    n = min(n, square.shape[0])
    transformed = fft.rfft(square / max(float(square.mean()), np.finfo(np.float32).tiny) - 1)
    return (
        fft.irfft(transformed[: n // 2 + 1], n) * (n / square.shape[0]),
        rate * n / square.shape[0],
    )


def _look(
    envelopes: list[tuple[AnyArray, float]], length: float, slowest: float, fastest: float
) -> _Followed | None:
    """The best lines over all bands in stretches of `length` [s]; None where they are too few, or
    too short for a floor.
    """
    looks = []
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
        looks.append(
            _Followed(followed, steady, (begin + way) * f_step, (m // 2) / rate, int(np.ptp(way)))
        )
    if not looks:
        return None
    best = max(looks, key=lambda look: look.followed)
    return replace(best, steady=max(look.steady for look in looks))


def _scores(values: AnyArray, m: int) -> AnyArray:
    """Score of every stretch of m samples and frequency, shape (stretches, lines of the spectrum up
    to a third of its end).
    """
    starts = np.arange(0, values.shape[0] - m + 1, m // 2)
    stretches = values[starts[:, None] + np.arange(m)] * np.hanning(m).astype(values.dtype)
    spectra = fft.rfft(stretches, _PADDED * m, axis=1)
    power = spectra.real**2 + spectra.imag**2
    blocks = power.shape[1] // _FLOOR
    floor = np.median(
        power[:, : blocks * _FLOOR].reshape(power.shape[0], blocks, _FLOOR), axis=2
    ) / np.log(2)
    floor = np.repeat(floor, _FLOOR, axis=1)
    ratio = np.log1p(power[:, : floor.shape[1]] / np.maximum(floor, 1e-30))
    ratio[:, : 2 * _PADDED] = 0.0
    reach = ratio.shape[1] // _HARMONICS
    return np.asarray(sum(ratio[:, : k * reach : k] for k in range(1, _HARMONICS + 1)))


def _follow(scores: AnyArray) -> tuple[float, AnyArray]:
    """The largest mean score of a way through the stretches, and that way, shape (stretches,)."""
    count, width = scores.shape
    steps = np.arange(-_FASTEST, _FASTEST + 1)
    backtrack = np.zeros((count, width), dtype=int)
    best = scores[0].astype(np.float64)
    for k in range(1, count):
        beside = np.pad(best, _FASTEST, constant_values=-np.inf)
        reached = np.stack([beside[_FASTEST + step : _FASTEST + step + width] for step in steps])
        chosen = reached.argmax(axis=0)
        backtrack[k] = steps[chosen]
        best = reached[chosen, np.arange(width)] + scores[k]
    way = [int(best.argmax())]
    for k in range(count - 1, 0, -1):
        way.append(way[-1] + int(backtrack[k][way[-1]]))
    return float(best.max() / count), np.array(way[::-1])


def _between_extremes(look: _Followed) -> MovingLine:
    begin, end = sorted((int(look.f.argmin()), int(look.f.argmax())))
    return MovingLine(
        float(look.f[begin]), float(look.f[end]), (end - begin) * look.hop, look.followed
    )
