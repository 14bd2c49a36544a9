"""Autoregressive model of coloured noise, and whitening with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput
from residuum.identification.linear_models.recursive_filter import all_pole
from residuum.identification.residual_analysis.noise.innovation_sums import whitened
from residuum.identification.residual_analysis.noise.noise_poles import first_predictors, within
from residuum.identification.residual_analysis.policy.noise import (
    LARGEST_REFLECTION,
    MEMORY_OF_ALL,
    MEMORY_OF_THE_LONGEST,
    SHORTEST_MEMORY,
)


@dataclass(frozen=True, eq=False)
class ColouredNoise:
    """v(k) + a₁ v(k−1) + … + a_p v(k−p) = e(k), e white with variance σ².

    Parameters
    ----------
    a : array, shape (p,)
        Coefficients of the whitening filter A(z) = 1 + a₁ z⁻¹ + …, all roots inside the unit circle.
    innovation_variance : float
        σ², in the square of the signal's unit.
    floor : float
        Variance that coarse steps of a reading hide; σ² is a part of it at least.
    """

    a: FloatArray
    innovation_variance: float
    floor: float = 0.0

    @property
    def order(self) -> int:
        """Number of coefficients p."""
        return int(self.a.shape[0])

    def whiten(self, x: FloatArray) -> FloatArray:
        """A(z) x along axis 0, without the first p samples; shape (n − p, …). NaN spreads over p samples."""
        rows = np.ascontiguousarray(np.reshape(x, (len(x), -1)).T, dtype=float)
        return np.asarray(whitened(rows, self.a).T.reshape(-1, *x.shape[1:]))

    def innovations(self, x: FloatArray) -> FloatArray:
        """A(z) x along axis 0 with the first p samples too: each has its own predictor from those before it, and is scaled to
        the innovations' variance. Shape of x; NaN spreads over p samples.
        """
        known = min(self.order, len(x))
        return np.concatenate([np.tensordot(self.first[0][:known, :known], x[:known], 1), self.whiten(x)])

    @cached_property
    def first(self) -> tuple[FloatArray, FloatArray]:
        """Rows of the scaled predictors of the first p samples (Levinson's recursion), and the logarithms of how far their errors
        spread, over the innovations.
        """
        rows, spreads = first_predictors(self.a, LARGEST_REFLECTION)
        return np.asarray(rows), np.asarray(spreads)

    def simulate(self, n: int, rng: np.random.Generator) -> FloatArray:
        """A realisation of v of n samples, after a run-in that forgets the zero start."""
        run_in = min(20_000, int(10 * self.time_constant) + 10 * self.order)
        e = rng.normal(scale=np.sqrt(self.innovation_variance), size=n + run_in)
        return all_pole(np.r_[1.0, self.a], e)[run_in:]

    @property
    def time_constant(self) -> float:
        """Samples after which the slowest mode has decayed to 1/e."""
        if self.order == 0:
            return 0.0
        slowest = float(np.abs(np.roots(np.r_[1.0, self.a])).max())
        return 0.0 if slowest <= 0 else 1.0 / max(-np.log(min(slowest, 1 - 1e-12)), 1e-12)


def fit_coloured_noise(segments: Sequence[FloatArray], order: int | None = None, *, highest_order: int = 16) -> ColouredNoise:
    """Fit the AR model by Burg's method to signal segments (no product is taken across a seam).

    Parameters
    ----------
    segments : sequence of arrays, shapes (n_i,)
        Parts of one signal without missing samples; their means are not removed.
    order : int or None
        p; None chooses it in 0 … `highest_order` by Akaike's criterion.

    Raises
    ------
    BadInput
        No segment is longer than the order.

    References
    ----------
    J. P. Burg, *Maximum entropy spectral analysis*, Stanford 1975: the lattice recursion is stable by construction,
    and less biased near the unit circle than Yule–Walker.
    """
    limit = highest_order if order is None else order
    usable = [np.asarray(segment, dtype=float) for segment in segments if len(segment) > 2 * limit]
    if not usable:
        raise BadInput(f"coloured noise of order {limit}: needs a stretch of more than {2 * limit} samples without a gap")
    power = sum(float(segment @ segment) for segment in usable) / sum(map(len, usable))
    forward, backward = usable, usable
    a = np.zeros(0)
    candidates = [(a, power)]
    n = sum(map(len, usable))
    for _ in range(limit):
        forward = [f[1:] for f in forward]
        backward = [b[:-1] for b in backward]
        cross = sum(float(f @ b) for f, b in zip(forward, backward, strict=True))
        energy = sum(float(f @ f) + float(b @ b) for f, b in zip(forward, backward, strict=True))
        k = -2.0 * cross / energy if energy > 0 else 0.0
        a = np.r_[a, 0.0] + k * np.r_[a[::-1], 1.0]
        power *= 1.0 - k * k
        forward, backward = (
            [f + k * b for f, b in zip(forward, backward, strict=True)],
            [b + k * f for f, b in zip(forward, backward, strict=True)],
        )
        candidates.append((a, power))
    if order is not None:
        return ColouredNoise(*candidates[order])
    akaike = [n * np.log(max(variance, 1e-300)) + 2 * len(coefficients) for coefficients, variance in candidates]
    return ColouredNoise(*candidates[int(np.argmin(akaike))])


def stretches(present: npt.NDArray[np.bool_]) -> list[slice]:
    """The runs of True in a mask, as slices in order."""
    edges = np.flatnonzero(np.diff(np.r_[False, present, False].astype(np.int8)))
    return [slice(int(start), int(stop)) for start, stop in zip(edges[::2], edges[1::2], strict=True)]


def longest_memory(samples: int, longest: int) -> float:
    """Samples over which noise may remember: a thirtieth of all, a fifth of the longest record.

    What is slower cannot be told from an error of the model, and must not be called noise.
    """
    return min(samples / MEMORY_OF_ALL, longest / MEMORY_OF_THE_LONGEST)


def pole_radius(memory: float) -> float:
    """Largest pole of noise that forgets over `memory` samples."""
    return float(np.exp(-1.0 / max(memory, SHORTEST_MEMORY)))


def forgetting(a: FloatArray, memory: float) -> FloatArray:
    """The autoregression with its poles kept within the radius that forgets over `memory` samples."""
    return np.asarray(within(a, pole_radius(memory))[0])
