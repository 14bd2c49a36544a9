"""What was known of parameters before a record, as rows of the least squares: (θ − μ)/σ each, a
measurement like any other.

With H the Gauss–Newton matrix of the data and P = diag(1/σ²) the estimate minimises ‖r‖² + (θ −
μ)ᵀP(θ − μ), and its covariance is (H + P)⁻¹. Where θ is drawn from its prior, a band of two
standard deviations covers it as often as it says.

Reference: A. Gelman et al., *Bayesian Data Analysis*, 2013, ch. 14.8.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.identification.physics.effects.base import Parameter

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Priors:
    """Normal priors of parameters: their `means` and `precisions` 1/σ², shape (q,) each; precision
    0 where nothing was known.
    """

    means: Array
    precisions: Array

    @classmethod
    def of(
        cls, parameters: Mapping[str, Parameter], names: Sequence[str], variance: float = 1.0
    ) -> Priors:
        """Those of the parameters of these names, beside squares of errors of which noise has this
        variance.
        """
        known = [parameters[name].prior for name in names]
        means = [0.0 if prior is None else prior.mean for prior in known]
        # In units of the errors' variance: rows of priors then count as rows of data do.
        precisions = [0.0 if prior is None else variance / prior.std**2 for prior in known]
        return cls(np.array(means), np.array(precisions))

    @property
    def count(self) -> int:
        """How many rows they are."""
        return int(np.count_nonzero(self.precisions))

    def cost(self, theta: Array) -> float:
        """Their squares at these values."""
        known = self.precisions > 0  # what no prior holds back may have run off, and has no square
        return float(self.precisions[known] @ (theta - self.means)[known] ** 2)

    def pull(self, theta: Array) -> Array:
        """How they draw the values back: what they add to the gradient Jᵀr of the data, shape
        (q,).
        """
        return self.precisions * (self.means - theta)
