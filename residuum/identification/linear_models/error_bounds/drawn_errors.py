"""Errors of drawn models as ratios of polynomials, so that they can be evaluated, and bounded, between frequencies too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.errors import BadModel

Polynomials = tuple[FloatArray, FloatArray]
FORMS = ("multiplicative", "additive", "inverse-multiplicative")
_VALUES_AT_ONCE = 2_000_000


@dataclass(frozen=True, eq=False)
class DrawnErrors:
    """|A_i(e^{jωTs})| / |B_i(e^{jωTs})|, the error of each drawn model against a nominal one.

    Parameters
    ----------
    numerators : array, shape (n, p)
        A_i in ascending powers of z⁻¹.
    denominators : array, shape (n, q) or (1, q)
        B_i in ascending powers of z⁻¹.
    sample_time : float
        Ts [s].
    form : {"multiplicative", "additive", "inverse-multiplicative"}
        G_i/G₀ − 1, G_i − G₀, or 1 − G₀/G_i.
    """

    numerators: FloatArray
    denominators: FloatArray
    sample_time: float
    form: str

    @classmethod
    def of(cls, drawn: Polynomials, nominal: Polynomials, sample_time: float, form: str) -> DrawnErrors:
        """Errors of G_i = N_i/D_i against G₀ = N₀/D₀, coefficient rows in ascending powers of z⁻¹."""
        (N, D), (N0, D0) = drawn, nominal
        mixed = _times(N, D0)
        difference = _sum(mixed, -_times(D, N0))
        below = {"multiplicative": _times(D, N0), "additive": _times(D, D0), "inverse-multiplicative": mixed}[form]
        return cls(difference, below, sample_time, form)

    @classmethod
    def joined(cls, parts: Sequence[DrawnErrors]) -> DrawnErrors:
        """The errors of several sets of models together."""
        numerators, denominators = ([getattr(part, name) for part in parts] for name in ("numerators", "denominators"))
        p, q = (max(rows.shape[1] for rows in many) for many in (numerators, denominators))
        if all(len(rows) == 1 and np.array_equal(_padded(rows, q), _padded(denominators[0], q)) for rows in denominators):
            below = _padded(denominators[0], q)
        else:
            below = np.vstack(
                [np.broadcast_to(_padded(b, q), (len(a), q)) for a, b in zip(numerators, denominators, strict=True)]
            )
        return cls(np.vstack([_padded(rows, p) for rows in numerators]), below, parts[0].sample_time, parts[0].form)

    @property
    def lags(self) -> int:
        """Highest lag of the polynomials."""
        return max(self.numerators.shape[1], self.denominators.shape[1]) - 1

    def envelope(self, omega: npt.ArrayLike) -> FloatArray:
        """Ω(ω) = max_i |A_i|/|B_i| (2.21), shape of `omega`.

        Raises
        ------
        BadModel
            A denominator is zero at a frequency, where a relative error means nothing.
        """
        omega = np.asarray(omega, dtype=float)
        largest = np.empty(len(omega))
        step = max(1, _VALUES_AT_ONCE // len(self.numerators))
        for first in range(0, len(omega), step):
            part = omega[first : first + step]
            above, below = (magnitude(rows, part * self.sample_time) for rows in (self.numerators, self.denominators))
            smallest = 1e-14 * np.abs(self.denominators).sum(axis=1, keepdims=True)
            if (below <= smallest).any():
                zero = part[np.argmax((below <= smallest).any(axis=0))]
                raise BadModel(
                    f"uncertainty weight: the response is zero at {zero:g} rad/s, where no {self.form} error exists; use additive"
                )
            largest[first : first + step] = (above / below).max(axis=0)
        return np.maximum(largest, np.finfo(float).tiny)


def magnitude(rows: FloatArray, angle: FloatArray) -> FloatArray:
    """|Σ_k a_k e^{−jkθ}| of each row, shape (rows, angles)."""
    phase = np.multiply.outer(np.arange(rows.shape[1]), angle)
    return np.asarray(np.hypot(rows @ np.cos(phase), rows @ np.sin(phase)))


def _times(a: FloatArray, b: FloatArray) -> FloatArray:
    """Products of polynomials row by row; a single row goes with every row of the other."""
    long, short = (a, b) if a.shape[1] >= b.shape[1] else (b, a)
    product = np.zeros((max(len(a), len(b)), a.shape[1] + b.shape[1] - 1))
    for k in range(short.shape[1]):
        product[:, k : k + long.shape[1]] += short[:, k : k + 1] * long
    return product


def _sum(a: FloatArray, b: FloatArray) -> FloatArray:
    size = max(a.shape[1], b.shape[1])
    return _padded(a, size) + _padded(b, size)


def _padded(rows: FloatArray, size: int) -> FloatArray:
    return np.pad(rows, ((0, 0), (0, size - rows.shape[1])))
