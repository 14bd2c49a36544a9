"""Linear least squares on whitened residuals: parameters common to all experiments, initial states each experiment's own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.innovation_sums import FREEDOM, normal_equations
from residuum.identification.discrepancy.innovations import Noises
from residuum.identification.physics.least_squares import damped, solve_scaled

FloatArray = npt.NDArray[np.float64]

RIDGE = 1e-11
"""Directions whose scaled curvature is below this fraction of the largest are left alone."""
SCORING = (FREEDOM + 3.0) / (FREEDOM + 1.0)
"""Curvature of the weighted squares over the expected one of the likelihood, whose weights fall as an innovation grows."""


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
        q = by_parameters[0].shape[2]
        H, g = np.zeros((q, q)), np.zeros(q)
        cross, own, own_gradient = [], [], []
        for r, J, Z in zip(residuals, by_parameters, by_states, strict=True):
            G, b = _gram(r, np.concatenate([J, Z], axis=2), noises)
            H += G[:q, :q]
            g += b[:q]
            cross.append(G[:q, q:])
            own.append(G[q:, q:])
            own_gradient.append(b[q:])
        return cls(H, g, np.array(cross), np.array(own), np.array(own_gradient))

    def step(self, damping: float = 0.0, held: npt.NDArray[np.bool_] | None = None) -> tuple[FloatArray, list[FloatArray]]:
        """Damped solution (θ, z of each experiment); `held` parameters stay where they are."""
        eliminated, H, g = self._eliminated(damping)
        free = np.ones(len(g), dtype=bool) if held is None else ~held
        theta = np.zeros(len(g))
        theta[free] = solve_scaled(H[np.ix_(free, free)], g[free, None], RIDGE)[:, 0]
        return theta, [K[:, -1] - K[:, :-1] @ theta for K in eliminated]

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
        K = solve_scaled(damped(self.own, damping), wanted, RIDGE)
        absorbed = np.einsum("kqm,kmc->qc", self.cross, K)
        return K, damped(self.H, damping) - absorbed[:, :-1], self.g - absorbed[:, -1]


def _gram(r: FloatArray, J: FloatArray, noises: Noises) -> tuple[FloatArray, FloatArray]:
    G, b = np.zeros((J.shape[2], J.shape[2])), np.zeros(J.shape[2])
    whole = np.ascontiguousarray(r), np.ascontiguousarray(J)  # for strided ones it would be compiled once more
    for o, noise in enumerate(noises):
        if noise is not None:
            of_output = normal_equations(*whole, o, noise.a, noise.first[0], noise.innovation_variance)
            G += of_output[0]
            b += of_output[1]
    return G, b
