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
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from residuum.identification.physics.effects.base import Parameter

if TYPE_CHECKING:
    from residuum.identification.physics.estimation.estimation import Estimate

Array = npt.NDArray[np.float64]
DISAGREE = 3.0
"""Combined standard deviations beyond which the data speak against a prior."""


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


def disagreement(found: Estimate) -> tuple[str, ...]:
    """One line that names the priors which the data speak against; none where they agree.

    An estimate θ̂ ± s from a prior μ ± σ and data moves by θ̂ − μ with the variance σ² − s². That
    many standard deviations it is off as the data alone are off the prior, measured in the
    deviation of both together.
    """
    said, parameters = [], found.model.all_parameters
    for name, value, s in zip(found.parameters, found.theta, found.std, strict=True):
        prior = parameters[name].prior
        if prior is None or not s < prior.std:
            continue
        off = abs(value - prior.mean) / np.sqrt(prior.std**2 - s**2)
        if off > DISAGREE:
            data = 1.0 / s**2 - 1.0 / prior.std**2
            alone = prior.mean + (value - prior.mean) / (s**2 * data)
            before = f"{prior.mean:g} ± {prior.std:g} before"
            said.append(
                f"{name} = {alone:.4g} by the data, {before} ({off:.1f} combined deviations)"
            )
    if not said:
        return ()
    return (
        (
            f"data and prior disagree: {'; '.join(said)}; the prior is wrong, or the model lacks an"
            " effect"
        ),
    )
