"""Filtering of a signal by a rational filter in q⁻¹."""

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from residuum.array_types import FloatArray


def filtered(b: npt.ArrayLike, a: npt.ArrayLike, x: FloatArray) -> FloatArray:
    """b(q⁻¹)/a(q⁻¹) x from rest, shape of `x`; an FIR filter is a convolution, which is several times faster."""
    b, a = np.atleast_1d(np.asarray(b, dtype=float)), np.atleast_1d(np.asarray(a, dtype=float))
    if len(a) > 1:
        return np.asarray(lfilter(b, a, x))
    if len(b) == 1:
        return np.asarray(b[0] / a[0] * x)
    return np.convolve(b / a[0], x)[: len(x)]
