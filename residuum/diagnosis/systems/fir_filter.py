"""Finite impulse response filter that remembers its past, so that blocks and single samples give the same numbers."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.kept_loops import njit


class FirFilter:
    """w(t) = Σ_k h_k v(t−k), fed block by block from rest.

    Each output is summed in the order of the taps whatever the block lengths, so cutting the input differently changes
    no bit of the result.

    >>> whole, halves = FirFilter([1.0, 0.5]), FirFilter([1.0, 0.5])
    >>> whole.process([1.0, 2.0, 3.0]).tolist() == [*halves.process([1.0]), *halves.process([2.0, 3.0])]
    True
    """

    def __init__(self, taps: npt.ArrayLike) -> None:
        self.taps: FloatArray = np.ascontiguousarray(taps, dtype=float)
        self.history: FloatArray = np.zeros(len(self.taps) - 1)

    def reset(self) -> None:
        """Forget the past."""
        self.history = np.zeros(len(self.taps) - 1)

    def process(self, v: npt.ArrayLike) -> FloatArray:
        """Output for the next block, shape of `v`."""
        past = np.concatenate([self.history, np.asarray(v, dtype=float)])
        self.history = past[len(past) - len(self.taps) + 1 :]
        return np.asarray(_convolve(self.taps, past))


_BLOCK = 1024  # outputs that stay in the first cache while the taps pass over them


@njit()
def _convolve(taps, past):  # type: ignore[no-untyped-def]
    """Eight taps a pass: the output is then loaded and stored an eighth as often, and added to in the same order."""
    m = len(taps)
    n = len(past) - m + 1
    w = np.zeros(n)
    for start in range(0, n, _BLOCK):
        size = min(_BLOCK, n - start)
        out = w[start : start + size]
        k = 0
        while k + 8 <= m:
            p = past[start + m - 8 - k :]
            h = taps[k : k + 8]
            h0, h1, h2, h3, h4, h5, h6, h7 = h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7]
            for t in range(size):
                early = out[t] + h0 * p[t + 7] + h1 * p[t + 6] + h2 * p[t + 5] + h3 * p[t + 4]
                out[t] = early + h4 * p[t + 3] + h5 * p[t + 2] + h6 * p[t + 1] + h7 * p[t]
            k += 8
        for rest in range(k, m):
            p = past[start + m - 1 - rest :]
            h0 = taps[rest]
            for t in range(size):
                out[t] += h0 * p[t]
    return w
