"""The kurtogram: in which frequency band, and at which width, is a signal most impulsive?"""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy import fft

from residuum.array_types import AnyArray
from residuum.diagnosis.residuals.filter_bank import (
    TAPS_OF_THIRDS,
    halves,
    length_of_half,
    length_of_third,
    moments_of_thirds,
    to_centre,
)
from residuum.diagnosis.vibration.spectra.long_transform import LONG, length_for_long, long_rfft
from residuum.identification.errors import BadInput
from residuum.kept_loops import njit

FEWEST_OF_A_BAND = 32  # samples of a band's envelope: its kurtosis then scatters by 2/√32 = 0.35
DEEPEST_LEVEL = 12


@dataclass(frozen=True)
class Band:
    """A frequency band: centre f_c and whole width b [Hz], level log₂(number of bands), and its kurtosis."""

    centre: float
    width: float
    level: float
    kurtosis: float

    @property
    def low(self) -> float:
        """Lower edge f_c − b/2 [Hz]."""
        return self.centre - self.width / 2

    @property
    def high(self) -> float:
        """Upper edge f_c + b/2 [Hz]."""
        return self.centre + self.width / 2


@dataclass(frozen=True, eq=False)
class Kurtogram:
    """Kurtosis of the envelope in every band of the ⅓-binary tree.

    Attributes
    ----------
    level, centre, width : arrays, shape (bands,)
        log₂ of the number of bands side by side; f_c [Hz]; whole width b [Hz].
    count : array, shape (bands,)
        Samples of the band's envelope.
    moments : array, shape (bands, segments, 2)
        Σ|c|² and Σ|c|⁴ of the complex envelope c in each of the equal time segments.
    sampling_rate : float
        Of the signal [Hz].
    """

    level: AnyArray
    centre: AnyArray
    width: AnyArray
    count: AnyArray
    moments: AnyArray
    sampling_rate: float

    @cached_property
    def kurtosis(self) -> AnyArray:
        """K = E|c|⁴ / (E|c|²)² − 2 a band (−3 instead of −2 for the real signal, level 0), shape (bands,); 0 = Gaussian."""
        return self._kurtosis(self.moments.sum(axis=1), self.count)

    @cached_property
    def kurtosis_of_segments(self) -> AnyArray:
        """The same a band and time segment, shape (bands, segments)."""
        return np.stack(
            [self._kurtosis(part, self.count / self.moments.shape[1]) for part in np.moveaxis(self.moments, 1, 0)], axis=1
        )

    @cached_property
    def power(self) -> AnyArray:
        """Mean square of the envelope a band and time segment, shape (bands, segments) [unit²]."""
        return self.moments[:, :, 0] / (self.count / self.moments.shape[1])[:, None]

    def _kurtosis(self, moments: AnyArray, count: AnyArray) -> AnyArray:
        second, fourth = moments[:, 0] / count, moments[:, 1] / count
        ratio = np.divide(fourth, second**2, out=np.zeros_like(second), where=second > np.finfo(float).tiny ** 0.5)
        gaussian = np.where(self.level == 0, 3.0, 2.0)
        return np.where(ratio > 0, ratio - gaussian, 0.0)

    def band(self, index: int) -> Band:
        """The band of that row."""
        return Band(float(self.centre[index]), float(self.width[index]), float(self.level[index]), float(self.kurtosis[index]))

    @property
    def best(self) -> Band:
        """The band of the largest kurtosis."""
        return self.band(int(np.argmax(self.kurtosis)))

    def in_order(self, merit: AnyArray | None = None) -> Iterator[Band]:
        """Bands from the best down by `merit` (default: kurtosis), leaving out those whose centre a better one covers."""
        taken: list[Band] = []
        for index in np.argsort(-(self.kurtosis if merit is None else merit), kind="stable"):
            band = self.band(int(index))
            if not any(other.low < band.centre < other.high or band.low < other.centre < band.high for other in taken):
                taken.append(band)
                yield band

    def as_map(self, merit: AnyArray | None = None) -> tuple[AnyArray, AnyArray, AnyArray]:
        """Levels, frequencies [Hz] and the picture of the kurtogram, shape (levels, 3 · 2^deepest); a cell a band repeated."""
        values = self.kurtosis if merit is None else merit
        levels = np.unique(self.level)
        columns = 3 << int(levels.max())
        frequency = (np.arange(columns) + 0.5) * self.sampling_rate / 2 / columns
        rows = [np.repeat(values[self.level == level], columns // int((self.level == level).sum())) for level in levels]
        return levels, frequency, np.stack(rows)


def kurtogram(
    x: npt.ArrayLike,
    sampling_rate: float,
    levels: int | None = None,
    *,
    segments: int = 1,
    method: Literal["filter-bank", "fft"] = "filter-bank",
) -> Kurtogram:
    """The fast kurtogram of a signal on the ⅓-binary tree.

    Levels 0, 1, …, `levels` halve the band 0 … fs/2 again and again; each band above the deepest is also cut in
    three (levels log₂3, 1 + log₂3, …). In each band the kurtosis of the complex envelope is taken; a train of short impacts
    that excites a resonance gives its largest value where the band just holds the resonance.

    When it fails: a few random impacts fool it (K grows with rarity), and at low signal-to-noise ratio a narrow band
    wins by chance; see `band_selection` for remedies.

    Parameters
    ----------
    x : array, shape (n,)
        float32 stays float32 in all large arrays (sums are double); the mean is removed.
    sampling_rate : float [Hz]
    levels : int or None
        Deepest level; None: the deepest, up to 7, whose bands keep 32 samples.
    segments : int
        Equal time segments for which moments are kept too (for robust choices and time-local power).
    method : "filter-bank" or "fft"
        The paper's 17- and 25-tap filters, or brick-wall bands cut out of one FFT: about three times faster, with
        edges that ring.

    Raises
    ------
    BadInput
        Not a vector, a missing sample, fewer than 128 samples, or more levels than the length allows.

    References
    ----------
    J. Antoni, MSSP 21 (2007) 108–124; J. Antoni, R. B. Randall, MSSP 20 (2006) 308–331.

    Examples
    --------
    Impacts every 20 ms ring at 3.2 kHz:

    >>> fs, t = 12800.0, np.arange(0, 0.02, 1 / 12800)
    >>> ring = np.tile(np.exp(-800 * t) * np.sin(2 * np.pi * 3200 * t), 100)
    >>> noise = np.random.default_rng(0).normal(scale=0.05, size=ring.size)
    >>> best = kurtogram(ring + noise, fs).best
    >>> best.low < 3200 < best.high
    True
    """
    x = _checked(x)
    deepest = _deepest(x.shape[0], levels)
    if segments < 1 or segments * FEWEST_OF_A_BAND > x.shape[0]:
        raise BadInput(f"kurtogram: segments is {segments}; must be at least 1 and leave {FEWEST_OF_A_BAND} samples each")
    if method not in ("filter-bank", "fft"):
        raise BadInput(f"kurtogram: method is {method!r}; must be 'filter-bank' or 'fft'")
    rows = _by_fft(x, deepest, segments) if method == "fft" else _by_filter_bank(x, deepest, segments)
    level, index, count, moments = (np.array(column) for column in zip(*sorted(rows, key=lambda row: row[:2]), strict=True))
    width = sampling_rate / 2 / np.rint(2.0**level)
    return Kurtogram(level, (index + 0.5) * width, width, count.astype(float), moments, float(sampling_rate))


Row = tuple[float, int, int, AnyArray]  # level, index of the band in it, samples, moments


def _checked(x: npt.ArrayLike) -> AnyArray:
    x = np.asarray(x)
    if x.ndim != 1 or x.shape[0] < 128:
        raise BadInput(f"kurtogram: signal has shape {x.shape}; must be a vector of at least 128 samples")
    if x.dtype != np.float32:
        x = x.astype(np.float64, copy=False)
    mean = x.mean(dtype=np.float64)
    if not np.isfinite(mean):
        raise BadInput("kurtogram: signal has a missing or infinite sample; must be finite")
    return x - x.dtype.type(mean)


def _deepest(n: int, levels: int | None) -> int:
    possible, half = 0, n
    while (
        length_of_half(half) >= FEWEST_OF_A_BAND
        and half > TAPS_OF_THIRDS
        and length_of_third(half) >= FEWEST_OF_A_BAND
        and possible < DEEPEST_LEVEL
    ):
        half = length_of_half(half)
        possible += 1
    if levels is None:
        return min(possible, 7)
    if not 1 <= levels <= possible:
        raise BadInput(f"kurtogram: levels is {levels}; a signal of {n} samples allows 1 … {possible}")
    return levels


def _by_filter_bank(x: AnyArray, deepest: int, segments: int) -> list[Row]:
    rows: list[Row] = [(0.0, 0, x.shape[0], _moments_of_signal(x, segments))]
    waiting = [(0, 0, to_centre(x))]
    while waiting:  # depth first, so that one node a level is in memory
        level, index, node = waiting.pop()
        n = node[0].shape[0]
        rows += [
            (level + np.log2(3), 3 * index + third, length_of_third(n), moments)
            for third, moments in enumerate(moments_of_thirds(node, segments))
        ]
        lower, upper, moments = halves(node, segments)
        for half, child in ((1, upper), (0, lower)):
            rows.append((level + 1.0, 2 * index + half, length_of_half(n), moments[half]))
            if level + 1 < deepest:
                waiting.append((level + 1, 2 * index + half, child))
    return rows


def _by_fft(x: AnyArray, deepest: int, segments: int) -> list[Row]:
    """Bands cut out of one spectrum in the signal's precision; each is transformed back in single, so none drowns in another."""
    n = x.shape[0]
    scale = float(np.abs(x).max()) or 1.0
    if n < LONG:
        padded = length_for_long(n, 6 << deepest)
        spectrum = (fft.rfft(x, padded)[: padded // 2] / scale).astype(np.complex64)
    else:
        padded = length_for_long(n, 6 << max(deepest, 5))
        spectrum = long_rfft(x, padded, gain=1.0 / scale, single=True)
    unit = np.array([scale**2, scale**4])

    def of_level(division: tuple[float, int]) -> list[Row]:
        level, bands = division
        envelope = fft.ifft(spectrum.reshape(bands, -1), axis=1)
        count = n * envelope.shape[1] // padded  # what lies beyond is padding
        return [
            (level, index, count, moments * unit) for index, moments in enumerate(_moments_of_rows(envelope, count, segments))
        ]

    rows: list[Row] = [(0.0, 0, n, _moments_of_signal(x, segments))]
    if n < LONG:
        return rows + [row for division in _divisions(deepest) for row in of_level(division)]
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # transforms and moments leave the interpreter free
        return rows + [row for found in pool.map(of_level, _divisions(deepest)) for row in found]


@njit(fastmath={"contract", "nsz", "reassoc"})
def _moments_of_rows(c: AnyArray, count: int, segments: int) -> AnyArray:
    """Σ|c|² and Σ|c|⁴ of the first `count` samples of each row, by time segment, shape (rows, segments, 2)."""
    moments = np.zeros((c.shape[0], segments, 2))
    for row in range(c.shape[0]):
        for segment in range(segments):
            second, fourth = 0.0, 0.0
            for k in range(-(-segment * count // segments), -(-(segment + 1) * count // segments)):
                power = float(c[row, k].real * c[row, k].real + c[row, k].imag * c[row, k].imag)
                second += power
                fourth += power * power
            moments[row, segment, 0], moments[row, segment, 1] = second, fourth
    return moments


def _divisions(deepest: int) -> Iterator[tuple[float, int]]:
    for level in range(deepest):
        yield level + 1.0, 2 << level
        yield level + np.log2(3), 3 << level


@njit(fastmath={"contract", "nsz", "reassoc"})
def _moments_of_signal(x: AnyArray, segments: int) -> AnyArray:
    """Σ x² and Σ x⁴ in each equal time segment, shape (segments, 2)."""
    n, moments = x.shape[0], np.zeros((segments, 2))
    for segment in range(segments):
        second, fourth = 0.0, 0.0
        for k in range(-(-segment * n // segments), -(-(segment + 1) * n // segments)):
            power = float(x[k]) * float(x[k])
            second += power
            fourth += power * power
        moments[segment, 0], moments[segment, 1] = second, fourth
    return moments
