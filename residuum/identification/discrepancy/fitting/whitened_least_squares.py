"""Linear least squares on whitened residuals: parameters common to all experiments, initial states each experiment's own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.policy.likelihood import FLAT_DIRECTION
from residuum.identification.physics.estimation.least_squares import damped, solve_scaled
from residuum.identification.residual_analysis.noise.innovation_sums import add_normal_equations, after_step
from residuum.identification.residual_analysis.noise.innovations import Noises
from residuum.identification.residual_analysis.policy.noise import SCORING

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Stacked:
    """Residuals r (n, outputs) of several experiments one after the other, with their slopes. J are those by parameters and Z
    those by first states (n, outputs, columns). Also where each experiment starts and the last one ends.
    """

    r: FloatArray
    J: FloatArray
    Z: FloatArray
    starts: npt.NDArray[np.int64]

    @classmethod
    def of(cls, residuals: Sequence[FloatArray], by_parameters: Sequence[FloatArray], by_states: Sequence[FloatArray]) -> Stacked:
        """Of one array an experiment; in one piece each, since for strided ones it would be compiled once more."""
        r, J, Z = (
            np.ascontiguousarray(each[0]) if len(each) == 1 else np.concatenate(each)
            for each in (residuals, by_parameters, by_states)
        )
        return cls(r, J, Z, np.cumsum([0, *map(len, residuals)]))

    def normal_equations(self, noises: Noises) -> NormalEquations:
        """Under these noises."""
        count, q, m = len(self.starts) - 1, self.J.shape[2], self.Z.shape[2]
        found = NormalEquations(
            np.zeros((q, q)), np.zeros(q), np.zeros((count, q, m)), np.zeros((count, m, m)), np.zeros((count, m))
        )
        sums = found.H, found.g, found.cross, found.own, found.own_gradient
        for o, noise in enumerate(noises):
            if noise is not None:
                whiten = noise.a, noise.first[0], noise.innovation_variance
                add_normal_equations(self.r, self.J, self.Z, self.starts, o, *whiten, *sums)
        return found

    def after(self, step: FloatArray, own: Sequence[FloatArray]) -> list[FloatArray]:
        """Residuals of each experiment after a step of the parameters and of its own first states."""
        rest = after_step(self.r, self.J, self.Z, self.starts, step, np.array(own))
        return [rest[a:b] for a, b in pairwise(self.starts.tolist())]


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """H θ = g with each experiment's own m unknowns z beside them.

    Shapes: H (q, q), g (q,), and one an experiment cross (experiments, q, m), own (experiments, m, m), own_gradient
    (experiments, m).
    """

    H: FloatArray
    g: FloatArray
    cross: FloatArray
    own: FloatArray
    own_gradient: FloatArray

    @classmethod
    def of(
        cls,
        residuals: Sequence[FloatArray],
        by_parameters: Sequence[FloatArray],
        by_states: Sequence[FloatArray],
        noises: Noises,
    ) -> NormalEquations:
        """From residuals (n, outputs) and their derivatives (n, outputs, columns), weighted as t-distributed innovations."""
        return Stacked.of(residuals, by_parameters, by_states).normal_equations(noises)

    def step(
        self, damping: float = 0.0, held: npt.NDArray[np.bool_] | None = None, ridge: float = FLAT_DIRECTION
    ) -> tuple[FloatArray, list[FloatArray]]:
        """Damped solution (θ, z of each experiment); `held` parameters stay where they are, as do directions below `ridge`."""
        eliminated, H, g = self._eliminated(damping)
        free = np.ones(len(g), dtype=bool) if held is None else ~held
        theta = np.zeros(len(g))
        theta[free] = solve_scaled(H[np.ix_(free, free)], g[free, None], ridge)[:, 0]
        return theta, list(eliminated[:, :, -1] - eliminated[:, :, :-1] @ theta)

    def decrement(self) -> float:
        """Log-likelihood that the full step of Fisher's scoring promises: ½·(step · gradient)."""
        theta, own = self.step()
        return 0.5 * SCORING * float(theta @ self.g + sum(z @ b for z, b in zip(own, self.own_gradient, strict=True)))

    def reduced(self) -> tuple[FloatArray, FloatArray]:
        """H (q, q) and g (q,) of the parameters once the experiments' own unknowns are free."""
        return self._eliminated(0.0)[1:]

    def information(self) -> FloatArray:
        """Fisher's information on the parameters once the experiments' own unknowns are free, shape (q, q)."""
        return self.reduced()[0] / SCORING

    def std(self) -> FloatArray:
        """Standard deviations of the parameters (infinite along directions without information), shape (q,)."""
        H = self.information()
        scale = np.sqrt(np.maximum(np.diag(H), 0.0))
        seen = (scale > 0) & np.all(np.isfinite(H), axis=0)
        found = np.full(len(scale), np.inf)
        if seen.any():
            values, vectors = np.linalg.eigh(H[np.ix_(seen, seen)] / scale[seen, None] / scale[seen])
            flat = values < 1e-9 * values[-1]
            inverse = np.sum(vectors[:, ~flat] ** 2 / values[~flat], axis=1)
            inverse[np.any(np.abs(vectors[:, flat]) > 1e-2, axis=1)] = np.inf
            found[seen] = np.sqrt(inverse) / scale[seen]
        return found

    def _eliminated(self, damping: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """own⁻¹ [crossᵀ own_gradient] of each experiment, and what is left of H and g without their unknowns."""
        wanted = np.concatenate([self.cross.swapaxes(1, 2), self.own_gradient[:, :, None]], axis=2)
        K = solve_scaled(damped(self.own, damping), wanted, FLAT_DIRECTION)
        absorbed = np.einsum("kqm,kmc->qc", self.cross, K)
        return K, damped(self.H, damping) - absorbed[:, :-1], self.g - absorbed[:, -1]
