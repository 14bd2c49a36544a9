"""What healthy simulation errors look like: one autoregression an output whitens them, so that errors can be weighed in nats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import toeplitz

from residuum.array_types import FloatArray
from residuum.identification.unseen_blocks.policy import WHITENING

Flags = npt.NDArray[np.bool_]
_CORRELATED = 0.05
"""Autocorrelation under which samples count as independent."""


@dataclass(frozen=True, eq=False)
class Whitening:
    """Of each output.

    Attributes
    ----------
    filters : array, shape (outputs, order + 1)
        1 − φ₁ z⁻¹ − …, order by Akaike's criterion, zero beyond it.
    sigma : array, shape (outputs,)
        RMS of whitened healthy errors.
    inflation : array, shape (outputs,)
        By which correlation that is left divides the number of samples.
    steps, most_steps : array, shape (outputs,)
        Half the mean square of steps from sample to sample, in sigma²: what is usual of their white part, and the most.
    """

    filters: FloatArray
    sigma: FloatArray
    inflation: FloatArray
    steps: FloatArray
    most_steps: FloatArray

    def white(self, values: FloatArray, known: Flags) -> FloatArray:
        """Values (n, outputs, …) whitened, over their healthy size; zero where nothing was measured."""
        out = np.empty(values.shape)
        for o, a in enumerate(self.filters):
            there = known[:, o].reshape((-1,) + (1,) * (values.ndim - 2))
            x = np.where(there, values[:, o], 0.0)
            y = x.copy()
            for lag in np.flatnonzero(a[1:]) + 1:
                y[lag:] += a[lag] * x[:-lag]
            out[:, o] = np.where(there, y, 0.0) / self.sigma[o]
        return out

    @property
    def amplified(self) -> FloatArray:
        """By how much whitening multiplies the steps' power of white noise, in sigma², shape (outputs,)."""
        steps = np.diff(self.filters, axis=1, prepend=0.0, append=0.0)
        return np.asarray(0.5 * np.sum(steps**2, axis=1) / self.sigma**2)

    @classmethod
    def plain(cls, sigma: FloatArray) -> Whitening:
        """None but the division by these sizes."""
        filters = np.zeros((len(sigma), WHITENING + 1))
        filters[:, 0] = 1.0
        return cls(filters, sigma, *np.ones((3, len(sigma))))

    @classmethod
    def of(cls, errors: Sequence[FloatArray]) -> Whitening:
        """Learned from the errors (n, outputs) of healthy windows; Yule-Walker equations."""
        outputs = errors[0].shape[1]
        found = cls.plain(np.ones(outputs))
        for o in range(outputs):
            x = [np.nan_to_num(r[:, o]) for r in errors]
            a = _autoregression(x)
            white = [np.convolve(y, a)[: len(y)] for y in x]
            rho = _autocorrelation(white, min(map(len, white)))
            end = int(np.argmax(rho < _CORRELATED)) or len(rho)
            sigma = max(float(np.sqrt(np.mean(np.concatenate(white) ** 2))), 1e-300)
            steps = [float(np.mean(np.diff(y) ** 2)) / 2.0 / sigma**2 for y in white]
            found.filters[o, : len(a)], found.sigma[o] = a, sigma
            found.inflation[o] = 1.0 + 2.0 * float(rho[1:end].sum())
            found.steps[o], found.most_steps[o] = np.mean(steps), np.mean(steps) + 2.0 * np.std(steps)
        return found


def _autoregression(x: Sequence[FloatArray]) -> FloatArray:
    rho, n = _autocorrelation(x, WHITENING + 1), sum(map(len, x))
    best, a = np.inf, np.ones(1)
    for p in range(WHITENING + 1):
        phi = np.linalg.solve(toeplitz(rho[:p]) + 1e-9 * np.eye(p), rho[1 : p + 1]) if p else np.zeros(0)
        aic = n * np.log(max(1.0 - float(phi @ rho[1 : p + 1]), 1e-12)) + 2.0 * p
        if aic < best:
            best, a = aic, np.concatenate([[1.0], -phi])
    return a


def _autocorrelation(x: Sequence[FloatArray], lags: int) -> FloatArray:
    total = np.sum([np.fft.irfft(np.abs(np.fft.rfft(y, 2 * len(y))) ** 2)[:lags] for y in x], axis=0)
    return np.asarray(total / max(float(total[0]), 1e-300))
