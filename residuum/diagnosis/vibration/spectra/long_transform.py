"""The spectrum of a long real signal, twice as fast as one long transform.

A transform of millions of samples waits for memory. Written as a matrix of 32 rows, n = n₁ N₂ + n₂, it becomes short transforms
down the columns, a turn of each element by e^{−2πi k₁ n₂/N}, and transforms along the rows, which fit the cache and
can share the cores; k = k₁ + 32 k₂ then puts the lines in order (Gentleman & Sande 1966, "Fast Fourier transforms for fun
and profit"; Bailey 1990). Half of the rows suffice, because the signal is real.
"""

from __future__ import annotations

import os

import numpy as np
from scipy import fft

from residuum.array_types import AnyArray
from residuum.kept_loops import njit

LONG = 1 << 18  # samples: below, one transform fits the cache
_ROWS = 32
_SPAN = 64  # columns between two exact turns
_BLOCK = 32


def length_for_long(n: int, multiple: int = 2 * _ROWS) -> int:
    """The least number from n on that is `multiple` times a product of small primes; `long_rfft` needs multiples of 64."""
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
                parts[row, start + j] = complex(value.real * a - value.imag * b, value.real * b + value.imag * a)


@njit()
def _in_order(parts: AnyArray, gain: float, lines: AnyArray) -> None:
    """Line k₁ + 32 k₂ from element (k₁, k₂), where k₁ > 16 from its mirror; columns in blocks, for the cache."""
    columns = parts.shape[1]
    for start in range(0, columns // 2, _BLOCK):
        stop = min(columns // 2, start + _BLOCK)
        for row in range(_ROWS // 2 + 1):
            for k in range(start, stop):
                lines[k * _ROWS + row] = gain * parts[row, k]
        for row in range(_ROWS // 2 + 1, _ROWS):
            for k in range(start, stop):
                lines[k * _ROWS + row] = gain * np.conj(parts[_ROWS - row, columns - 1 - k])
