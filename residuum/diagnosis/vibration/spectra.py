"""Spectra, bands and envelopes of a vibration."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from scipy import fft

from residuum.array_types import AnyArray, FloatArray
from residuum.diagnosis.vibration.filter_bank import (
    TAPS_OF_THIRDS,
    halves,
    length_of_half,
    length_of_third,
    moments_of_thirds,
    to_centre,
)
from residuum.identification.errors import BadInput
from residuum.kept_loops import njit

# Amplitude spectrum of a signal.


@dataclass(frozen=True, eq=False)
class AmplitudeSpectrum:
    """Amplitudes [unit of the signal] at 0, step, 2·step … [Hz]; `resolution` is the window's
    half-power width [Hz].
    """

    step: float
    amplitude: FloatArray
    resolution: float


def amplitude_spectrum(signal: npt.NDArray[Any], sample_time: float) -> AmplitudeSpectrum:
    """Amplitude spectrum |X(f)|: a sine of amplitude A at a bin shows as A.

    Mean removed, Hann window w, X = 2 |FFT(w x)| / Σw. Missing samples count as the mean. The
    length is padded to one the FFT likes, so a long prime-length window costs no more than its
    neighbour.

    >>> t = np.arange(1000) / 1000
    >>> float(amplitude_spectrum(3 * np.sin(2 * np.pi * 50 * t), 1e-3).amplitude.max().round(2))
    3.0
    """
    n = signal.shape[0]
    padded = fft.next_fast_len(n, real=True)
    # all that is held of a long signal, beside its spectrum: the rest is done in place
    x = np.zeros(padded)
    x[:n] = signal
    missing = np.isnan(x)
    count = n - np.count_nonzero(missing)
    x[missing] = 0.0
    x[:n] -= x.sum() / max(1, count)
    x[missing] = 0.0
    if n > 2:
        window = np.arange(n) * (2 * np.pi / n)
        np.cos(window, out=window)
        window *= -0.5
        window += 0.5
        x[:n] *= window
        del window
    amplitude = np.abs(fft.rfft(x, overwrite_x=True))
    # over Σw, which is n/2 for a Hann window over whole periods
    amplitude *= 2 / (n / 2 if n > 2 else n)
    return AmplitudeSpectrum(1 / (padded * sample_time), amplitude, 1.44 / (n * sample_time))


# The spectrum of a long real signal, twice as fast as one long transform.
# A transform of millions of samples waits for memory. Written as a matrix of 32 rows, n = n₁ N₂ +
# n₂, it becomes short transforms down the columns, a turn of each element by e^{−2πi k₁ n₂/N},
# and transforms along the rows, which fit the cache and can share the cores; k = k₁ + 32 k₂ then
# puts the lines in order (Gentleman & Sande 1966, "Fast Fourier transforms for fun and profit";
# Bailey 1990). Half of the rows suffice, because the signal is real.

LONG = 1 << 18  # samples: below, one transform fits the cache
_ROWS = 32
_SPAN = 64  # columns between two exact turns
_BLOCK = 32


def length_for_long(n: int, multiple: int = 2 * _ROWS) -> int:
    """The least number from n on that is `multiple` times a product of small primes; `long_rfft`
    needs multiples of 64.
    """
    return multiple * int(fft.next_fast_len(-(-n // multiple)))


def long_rfft(x: AnyArray, padded: int, *, gain: float = 1.0, single: bool = False) -> AnyArray:
    """Lines 0 … padded/2 − 1 of the spectrum of `gain` · x, shape (padded / 2,).

    Parameters
    ----------
    x : array, shape (n,), real; float32 is transformed in single precision
    padded : int
        Length after padding with zeros; a multiple of 64, see `length_for_long`.
    gain : float
        Factor on the result.
    single : bool
        Give complex64, rounded after the transform.

    Examples
    --------
    >>> x = np.random.default_rng(0).standard_normal(64 * 75)
    >>> bool(np.abs(long_rfft(x, x.size) - np.fft.rfft(x)[:-1]).max() < 1e-11)
    True
    """
    if x.shape[0] < padded:
        x = np.concatenate([x, np.zeros(padded - x.shape[0], x.dtype)])
    workers = os.cpu_count() if padded >= LONG else 1
    parts = fft.rfft(x.reshape(_ROWS, -1), axis=0, workers=workers)
    _turn(parts, padded)
    parts = fft.fft(parts, axis=1, overwrite_x=True, workers=workers)
    lines = np.empty(padded // 2, np.complex64 if single else parts.dtype)
    _in_order(parts, gain, lines)
    return lines


@njit(fastmath={"contract", "nsz"})
def _turn(parts: AnyArray, n: int) -> None:
    """Multiply element (k₁, n₂) by e^{−2πi k₁ n₂/n}."""
    real, imag = np.empty(_SPAN), np.empty(_SPAN)
    for row in range(1, parts.shape[0]):
        angle = -2 * np.pi * row / n
        for j in range(_SPAN):
            real[j], imag[j] = np.cos(angle * j), np.sin(angle * j)
        for start in range(0, parts.shape[1], _SPAN):
            re, im = np.cos(angle * start), np.sin(angle * start)
            for j in range(min(_SPAN, parts.shape[1] - start)):
                a, b = re * real[j] - im * imag[j], re * imag[j] + im * real[j]
                value = parts[row, start + j]
                parts[row, start + j] = complex(
                    value.real * a - value.imag * b, value.real * b + value.imag * a
                )


@njit()
def _in_order(parts: AnyArray, gain: float, lines: AnyArray) -> None:
    """Line k₁ + 32 k₂ from element (k₁, k₂), where k₁ > 16 from its mirror; columns in blocks, for
    the cache.
    """
    columns = parts.shape[1]
    for start in range(0, columns // 2, _BLOCK):
        stop = min(columns // 2, start + _BLOCK)
        for row in range(_ROWS // 2 + 1):
            for k in range(start, stop):
                lines[k * _ROWS + row] = gain * parts[row, k]
        for row in range(_ROWS // 2 + 1, _ROWS):
            for k in range(start, stop):
                lines[k * _ROWS + row] = gain * np.conj(parts[_ROWS - row, columns - 1 - k])


# Envelope of one frequency band of a signal, and its spectrum.

_OVERSAMPLING = 2  # a squared envelope reaches to ±b for a band of width b


@dataclass(frozen=True, eq=False)
class Envelope:
    """Envelope r_e(t) = |r(t) + j H{r}(t)| of a band-passed signal r.

    Attributes
    ----------
    values : array, shape (m,)
        In the signal's unit; an amplitude, so its RMS is √2 times that of r.
    sampling_rate : float
        Of the envelope [Hz]: the signal's own, or lower when decimated.
    low, high : float
        Edges of the band [Hz].
    """

    values: AnyArray
    sampling_rate: float
    low: float
    high: float

    def spectrum(
        self, kind: Literal["squared", "amplitude"] = "squared"
    ) -> tuple[AnyArray, AnyArray]:
        """Frequencies [Hz] and one-sided amplitudes of the (squared) envelope, its mean included at
        0 Hz.

        The amplitude of the squared envelope at α, divided by that at 0, is the modulation at α: 1
        for full modulation. A length with a large prime factor is padded by less than 1 %.
        """
        y = self.values * self.values if kind == "squared" else self.values
        n = y.shape[0]
        padded = fft.next_fast_len(n, real=True)
        mean = y.mean(dtype=np.float64)
        amplitude = np.abs(fft.rfft(y - y.dtype.type(mean), padded)) * y.dtype.type(2 / n)
        amplitude[0] = mean
        return np.arange(amplitude.shape[0]) * (self.sampling_rate / padded), amplitude


def band_envelope(
    x: npt.ArrayLike, sampling_rate: float, low: float, high: float, *, decimate: bool = True
) -> Envelope:
    """Envelope of the band low … high of a signal, by one forward and one short inverse FFT.

    The band is cut with straight edges (zero phase). `decimate` keeps twice the samples that the
    band needs, which represents the squared envelope without aliasing; otherwise the signal's own
    rate is kept.

    Parameters
    ----------
    x : array, shape (n,), without missing samples; float32 stays float32
    sampling_rate, low, high : float [Hz], 0 ≤ low < high ≤ sampling_rate / 2

    Raises
    ------
    BadInput
        The band is empty, outside 0 … fs/2 or narrower than four lines of the spectrum.

    Examples
    --------
    A 1 kHz tone of amplitude 3, modulated fully at 10 Hz:

    >>> t = np.arange(8000) / 8000
    >>> tone = 3 * (1 + np.cos(2 * np.pi * 10 * t)) * np.cos(2 * np.pi * 1000 * t)
    >>> envelope = band_envelope(tone, 8000, 900, 1100)
    >>> frequency, amplitude = envelope.spectrum("amplitude")
    >>> round(float(amplitude[0]), 6), float(frequency[1:][np.argmax(amplitude[1:])])
    (3.0, 10.0)
    """
    return PaddedSpectrum.of(np.asarray(x), sampling_rate).envelope(low, high, decimate=decimate)


@dataclass(frozen=True, eq=False)
class PaddedSpectrum:
    """Spectrum of a real signal at a length without large prime factors, for many bands of it.

    Attributes
    ----------
    lines : array, shape (padded / 2 or one more,), complex
        From 0 Hz on; of a long signal all but the last one.
    padded, n : int
        Length after padding with zeros, and the signal's own.
    sampling_rate : float
        [Hz]
    """

    lines: AnyArray
    padded: int
    n: int
    sampling_rate: float

    @classmethod
    def of(cls, x: AnyArray, sampling_rate: float) -> PaddedSpectrum:
        """Of a signal, shape (n,); float32 stays in single precision."""
        n = x.shape[0]
        if n >= LONG:
            padded = length_for_long(n)
            x = x if x.dtype == np.float32 else np.asarray(x, dtype=np.float64)
            return cls(long_rfft(x, padded), padded, n, sampling_rate)
        padded = fft.next_fast_len(n, real=True)
        return cls(np.asarray(fft.rfft(x, padded)), padded, n, sampling_rate)

    def envelope(self, low: float, high: float, *, decimate: bool = True) -> Envelope:
        """`band_envelope` of the signal.

        The band's lines, moved down to 0 Hz, are the spectrum of the analytic signal but for its
        centre frequency, which the modulus does not see.
        """
        rate, padded = self.sampling_rate, self.padded
        if not 0 <= low < high <= rate / 2 * (1 + 1e-9):
            raise BadInput(f"band {low:g} … {high:g} Hz: must lie inside 0 … {rate / 2:g} Hz")
        first = max(1, int(np.ceil(low * padded / rate)))
        last = min(int(np.ceil(high * padded / rate)), self.lines.shape[0])
        if last - first < 4:
            raise BadInput(
                f"band {low:g} … {high:g} Hz: is narrower than four lines of {rate / padded:g} Hz"
            )
        m = min(fft.next_fast_len(_OVERSAMPLING * (last - first)), padded) if decimate else padded
        band = np.zeros(m, self.lines.dtype)
        band[: last - first] = self.lines[first:last]
        # what lies beyond the signal's own length is the envelope of the padding
        analytic = fft.ifft(band, overwrite_x=True)[: max(1, self.n * m // padded)]
        # twice, since an analytic signal has the lines of positive frequency alone
        scale = analytic.real.dtype.type(2 * m / padded)
        return Envelope(np.abs(analytic) * scale, rate * m / padded, float(low), float(high))


# The kurtogram: in which frequency band, and at which width, is a signal most impulsive?

FEWEST_OF_A_BAND = 32  # samples of a band's envelope: its kurtosis then scatters by 2/√32 = 0.35
DEEPEST_LEVEL = 12


@dataclass(frozen=True)
class Band:
    """A frequency band: centre f_c and whole width b [Hz], level log₂(number of bands), and its
    kurtosis.
    """

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
        """K = E|c|⁴ / (E|c|²)² − 2 a band (−3 instead of −2 for the real signal, level 0), shape
        (bands,); 0 = Gaussian.
        """
        return self._kurtosis(self.moments.sum(axis=1), self.count)

    @cached_property
    def kurtosis_of_segments(self) -> AnyArray:
        """The same a band and time segment, shape (bands, segments)."""
        return np.stack(
            [
                self._kurtosis(part, self.count / self.moments.shape[1])
                for part in np.moveaxis(self.moments, 1, 0)
            ],
            axis=1,
        )

    @cached_property
    def power(self) -> AnyArray:
        """Mean square of the envelope a band and time segment, shape (bands, segments) [unit²]."""
        return self.moments[:, :, 0] / (self.count / self.moments.shape[1])[:, None]

    def _kurtosis(self, moments: AnyArray, count: AnyArray) -> AnyArray:
        second, fourth = moments[:, 0] / count, moments[:, 1] / count
        ratio = np.divide(
            fourth, second**2, out=np.zeros_like(second), where=second > np.finfo(float).tiny ** 0.5
        )
        gaussian = np.where(self.level == 0, 3.0, 2.0)
        return np.where(ratio > 0, ratio - gaussian, 0.0)

    def band(self, index: int) -> Band:
        """The band of that row."""
        return Band(
            float(self.centre[index]),
            float(self.width[index]),
            float(self.level[index]),
            float(self.kurtosis[index]),
        )

    @property
    def best(self) -> Band:
        """The band of the largest kurtosis."""
        return self.band(int(np.argmax(self.kurtosis)))

    def in_order(self, merit: AnyArray | None = None) -> Iterator[Band]:
        """Bands from the best down by `merit` (default: kurtosis), leaving out those whose centre a
        better one covers.
        """
        taken: list[Band] = []
        for index in np.argsort(-(self.kurtosis if merit is None else merit), kind="stable"):
            band = self.band(int(index))
            if not any(
                better.low < band.centre < better.high or band.low < better.centre < band.high
                for better in taken
            ):
                taken.append(band)
                yield band

    def as_map(self, merit: AnyArray | None = None) -> tuple[AnyArray, AnyArray, AnyArray]:
        """Levels, frequencies [Hz] and the picture of the kurtogram, shape (levels, 3 · 2^deepest);
        a cell a band repeated.
        """
        values = self.kurtosis if merit is None else merit
        levels = np.unique(self.level)
        columns = 3 << int(levels.max())
        frequency = (np.arange(columns) + 0.5) * self.sampling_rate / 2 / columns
        rows = [
            np.repeat(values[self.level == level], columns // int((self.level == level).sum()))
            for level in levels
        ]
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

    Levels 0, 1, …, `levels` halve the band 0 … fs/2 again and again; each band above the deepest is
    also cut in three (levels log₂3, 1 + log₂3, …). In each band the kurtosis of the complex
    envelope is taken; a train of short impacts that excites a resonance gives its largest value
    where the band just holds the resonance.

    When it fails: a few random impacts fool it (K grows with rarity), and at low signal-to-noise
    ratio a narrow band wins by chance; see `benchmarks/peers/band_selection.py` for remedies.

    Parameters
    ----------
    x : array, shape (n,)
        float32 stays float32 in all large arrays (sums are double); the mean is removed.
    sampling_rate : float [Hz]
    levels : int or None
        Deepest level; None: the deepest, up to 7, whose bands keep 32 samples.
    segments : int
        Equal time segments for which moments are kept too (for robust choices and time-local
        power).
    method : "filter-bank" or "fft"
        The paper's 17- and 25-tap filters, or brick-wall bands cut out of one FFT: about three
        times faster, with edges that ring.

    Raises
    ------
    BadInput
        Not a vector, a missing sample, fewer than 128 samples, or more levels than the length
        allows.

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
        raise BadInput(
            f"kurtogram: segments is {segments}; must be at least 1 and leave {FEWEST_OF_A_BAND}"
            " samples each"
        )
    if method not in ("filter-bank", "fft"):
        raise BadInput(f"kurtogram: method is {method!r}; must be 'filter-bank' or 'fft'")
    rows = (
        _by_fft(x, deepest, segments) if method == "fft" else _by_filter_bank(x, deepest, segments)
    )
    level, index, count, moments = (
        np.array(column) for column in zip(*sorted(rows, key=lambda row: row[:2]), strict=True)
    )
    width = sampling_rate / 2 / np.rint(2.0**level)
    return Kurtogram(
        level, (index + 0.5) * width, width, count.astype(float), moments, float(sampling_rate)
    )


Row = tuple[float, int, int, AnyArray]  # level, index of the band in it, samples, moments


def _checked(x: npt.ArrayLike) -> AnyArray:
    x = np.asarray(x)
    if x.ndim != 1 or x.shape[0] < 128:
        raise BadInput(
            f"kurtogram: signal has shape {x.shape}; must be a vector of at least 128 samples"
        )
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
        raise BadInput(
            f"kurtogram: levels is {levels}; a signal of {n} samples allows 1 … {possible}"
        )
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
    """Bands cut out of one spectrum in the signal's precision; each is transformed back in single,
    so none drowns in another.
    """
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
            (level, index, count, moments * unit)
            for index, moments in enumerate(_moments_of_rows(envelope, count, segments))
        ]

    rows: list[Row] = [(0.0, 0, n, _moments_of_signal(x, segments))]
    if n < LONG:
        return rows + [row for division in _divisions(deepest) for row in of_level(division)]
    # transforms and moments leave the interpreter free
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return rows + [row for group in pool.map(of_level, _divisions(deepest)) for row in group]


@njit(fastmath={"contract", "nsz", "reassoc"})
def _moments_of_rows(c: AnyArray, count: int, segments: int) -> AnyArray:
    """Σ|c|² and Σ|c|⁴ of the first `count` samples of each row, by time segment, shape (rows,
    segments, 2).
    """
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


# RMS of a vibration in octave bands of fixed hertz, comparable between records of different rate
# and length.

_ANCHOR = 62.5  # Hz; edges are this times powers of two
_FEWEST_LINES = 8


def octave_edges(sampling_rate: float, duration: float) -> AnyArray:
    """Edges [Hz] of the bands that a record of this rate and duration [s] can resolve, the last one
    fs/2.

    The topmost band is cut at fs/2; when less than a quarter octave of it is left it joins the one
    below.

    >>> octave_edges(12000, 1.0).tolist()
    [15.625, 31.25, 62.5, 125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0, 6000.0]
    """
    lowest = int(np.ceil(np.log2(_FEWEST_LINES / duration / _ANCHOR)))
    top = sampling_rate / 2
    highest = int(np.floor(np.log2(top / 2**0.25 / _ANCHOR)))
    if highest < lowest:
        raise BadInput(
            f"octave bands: {duration:g} s at {sampling_rate:g} Hz is too short for one band"
        )
    return np.append(_ANCHOR * 2.0 ** np.arange(lowest, highest + 1), top)


def octave_rms(x: npt.ArrayLike, sampling_rate: float, edges: AnyArray) -> AnyArray:
    """RMS of a signal in the bands between the edges, shape (bands,), by Parseval's sum over a
    Hann-windowed spectrum.
    """
    x = np.asarray(x)
    window = np.hanning(x.shape[0]).astype(x.dtype)
    padded = fft.next_fast_len(x.shape[0], real=True)
    power = np.abs(fft.rfft((x - x.mean()) * window, padded)) ** 2
    cuts = np.minimum(np.ceil(edges * padded / sampling_rate).astype(int), power.shape[0])
    sums = np.array([power[low:high].sum(dtype=np.float64) for low, high in pairwise(cuts)])
    return np.asarray(np.sqrt(2 * sums / (padded * float(np.sum(window.astype(float) ** 2)))))
