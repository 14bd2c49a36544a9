"""Envelope of one frequency band of a signal, and its spectrum."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy import fft

from residuum.array_types import AnyArray
from residuum.diagnosis.vibration.spectra.long_transform import LONG, length_for_long, long_rfft
from residuum.identification.errors import BadInput

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

    def spectrum(self, kind: Literal["squared", "amplitude"] = "squared") -> tuple[AnyArray, AnyArray]:
        """Frequencies [Hz] and one-sided amplitudes of the (squared) envelope, its mean included at 0 Hz.

        The amplitude of the squared envelope at α, divided by that at 0, is the modulation at α: 1 for full modulation.
        A length with a large prime factor is padded by less than 1 %.
        """
        y = self.values * self.values if kind == "squared" else self.values
        n = y.shape[0]
        padded = fft.next_fast_len(n, real=True)
        mean = y.mean(dtype=np.float64)
        amplitude = np.abs(fft.rfft(y - y.dtype.type(mean), padded)) * y.dtype.type(2 / n)
        amplitude[0] = mean
        return np.arange(amplitude.shape[0]) * (self.sampling_rate / padded), amplitude


def band_envelope(x: npt.ArrayLike, sampling_rate: float, low: float, high: float, *, decimate: bool = True) -> Envelope:
    """Envelope of the band low … high of a signal, by one forward and one short inverse FFT.

    The band is cut with straight edges (zero phase). `decimate` keeps twice the samples that the band needs,
    which represents the squared envelope without aliasing; otherwise the signal's own rate is kept.

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
    x = np.asarray(x)
    spectrum, padded = padded_spectrum(x)
    return envelope_of_spectrum(spectrum, padded, x.shape[0], sampling_rate, low, high, decimate=decimate)


def padded_spectrum(x: AnyArray) -> tuple[AnyArray, int]:
    """rfft of a signal at a length without large prime factors (of a long one all but the last line), and that length."""
    if x.shape[0] >= LONG:
        padded = length_for_long(x.shape[0])
        return long_rfft(x if x.dtype == np.float32 else np.asarray(x, dtype=np.float64), padded), padded
    padded = fft.next_fast_len(x.shape[0], real=True)
    return np.asarray(fft.rfft(x, padded)), padded


def envelope_of_spectrum(
    spectrum: AnyArray, padded: int, n: int, sampling_rate: float, low: float, high: float, *, decimate: bool = True
) -> Envelope:
    """`band_envelope` of a signal of n samples from its `padded_spectrum` (for many bands of one signal)."""
    if not 0 <= low < high <= sampling_rate / 2 * (1 + 1e-9):
        raise BadInput(f"band {low:g} … {high:g} Hz: must lie inside 0 … {sampling_rate / 2:g} Hz")
    first = max(1, int(np.ceil(low * padded / sampling_rate)))
    last = min(int(np.ceil(high * padded / sampling_rate)), spectrum.shape[0])
    if last - first < 4:
        raise BadInput(f"band {low:g} … {high:g} Hz: is narrower than four lines of {sampling_rate / padded:g} Hz")
    m = min(fft.next_fast_len(_OVERSAMPLING * (last - first)), padded) if decimate else padded
    band = np.zeros(m, spectrum.dtype)
    band[: last - first] = spectrum[first:last]
    analytic = fft.ifft(band, overwrite_x=True)[: max(1, n * m // padded)]
    scale = analytic.real.dtype.type(2 * m / padded)
    return Envelope(np.abs(analytic) * scale, sampling_rate * m / padded, float(low), float(high))
