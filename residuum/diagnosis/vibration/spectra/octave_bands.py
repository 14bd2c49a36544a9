"""RMS of a vibration in octave bands of fixed hertz, comparable between records of different rate and length."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy import fft

from residuum.array_types import AnyArray
from residuum.identification.errors import BadInput

_ANCHOR = 62.5  # Hz; edges are this times powers of two
_FEWEST_LINES = 8


def octave_edges(sampling_rate: float, duration: float) -> AnyArray:
    """Edges [Hz] of the bands that a record of this rate and duration [s] can resolve, the last one fs/2.

    The topmost band is cut at fs/2; when less than a quarter octave of it is left it joins the one below.

    >>> octave_edges(12000, 1.0).tolist()
    [15.625, 31.25, 62.5, 125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0, 6000.0]
    """
    lowest = int(np.ceil(np.log2(_FEWEST_LINES / duration / _ANCHOR)))
    top = sampling_rate / 2
    highest = int(np.floor(np.log2(top / 2**0.25 / _ANCHOR)))
    if highest < lowest:
        raise BadInput(f"octave bands: {duration:g} s at {sampling_rate:g} Hz is too short for one band")
    return np.append(_ANCHOR * 2.0 ** np.arange(lowest, highest + 1), top)


def octave_rms(x: npt.ArrayLike, sampling_rate: float, edges: AnyArray) -> AnyArray:
    """RMS of a signal in the bands between the edges, shape (bands,), by Parseval's sum over a Hann-windowed spectrum."""
    x = np.asarray(x)
    window = np.hanning(x.shape[0]).astype(x.dtype)
    padded = fft.next_fast_len(x.shape[0], real=True)
    power = np.abs(fft.rfft((x - x.mean()) * window, padded)) ** 2
    cuts = np.minimum(np.ceil(edges * padded / sampling_rate).astype(int), power.shape[0])
    sums = np.array([power[low:high].sum(dtype=np.float64) for low, high in pairwise(cuts)])
    return np.asarray(np.sqrt(2 * sums / (padded * float(np.sum(window.astype(float) ** 2)))))
