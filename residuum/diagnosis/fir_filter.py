"""Finite impulse response filter that remembers its past, so that blocks and single samples give the same numbers."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

from residuum.diagnosis.state_space import FloatArray


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


@numba.njit(cache=True)
def _convolve(taps, past):  # type: ignore[no-untyped-def]
    m = len(taps)
    n = len(past) - m + 1
    w = np.zeros(n)
    block = 2048  # keeps the output in the first cache while the taps pass over it
    for start in range(0, n, block):
        stop = min(n, start + block)
        for k in range(m):
            h, shift = taps[k], m - 1 - k
            for t in range(start, stop):
                w[t] += h * past[t + shift]
    return w
