"""Structures: a model with some effects, re-estimated together with the colour of its noise, and how likely the data are then.

Each output's residual v is autoregressive, A(q) v = e, with coefficients of its own *in every structure*: what remains of
a complete model is its noise, what remains of an incomplete one is noise plus the error, and comparing the likelihood of the
innovations e compares the two without ever assuming white noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.fitting.ascent import Point
from residuum.identification.discrepancy.policy.likelihood import MUCH_WORSE
from residuum.identification.physics import Key, PhysicalModel
from residuum.identification.residual_analysis.noise.innovations import Noises

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Structure:
    """A model re-estimated with coloured noise.

    Attributes
    ----------
    model : PhysicalModel
        With the estimated values.
    parameters : tuple of str
        Full names of what was estimated; `std` their standard deviations, shape (q,).
    initial, substeps : per experiment
        First states in kernel order; integration steps a sample.
    residuals : list of array, shapes (blocks, outputs)
        y − ŷ in the outputs' units, means over the experiments' blocks.
    noises : tuple
        Colour of each output's residual.
    reading : array, shape (outputs,)
        Variance that coarse steps hide of each output.
    by_parameters, by_states : list of array, shapes (blocks, outputs, q) and (blocks, outputs, free initial states)
        Derivatives of ŷ there, in the outputs' units a unit of each.
    pointwise : array
        Log-likelihood of each innovation; their sum is `log_likelihood`.
    rmse : array, shape (outputs,)
        Root mean square of y − ŷ, every sample counted; NaN for an output that was never measured.
    at_bound : tuple of str
    drifting : bool
        Whether the noise may be integrated.
    at_top : bool
        Whether it was climbed until that gained nothing more.
    """

    model: PhysicalModel
    parameters: tuple[str, ...]
    std: FloatArray
    initial: list[FloatArray]
    substeps: tuple[int, ...]
    residuals: list[FloatArray]
    by_parameters: list[FloatArray]
    by_states: list[FloatArray]
    noises: Noises
    reading: FloatArray
    pointwise: FloatArray
    rmse: FloatArray
    at_bound: tuple[str, ...] = ()
    drifting: bool = False
    at_top: bool = False

    @property
    def doubts(self) -> dict[str, float]:
        """Standard deviations of the estimated parameters, by full name."""
        return dict(zip(self.parameters, self.std.tolist(), strict=True))

    @property
    def log_likelihood(self) -> float:
        """Of the innovations at the estimate."""
        return float(self.pointwise.sum())

    @property
    def samples(self) -> int:
        """Number of innovations."""
        return int(self.pointwise.size)

    def label_of(self, key: Key) -> str:
        """Label of the effect that the candidate (id, target) became in this model."""
        return next(use.label for use in self.model.effects if use.key == key)

    def penalty(self, base: Structure) -> float:
        """½ log n for every free parameter more than the base has (Schwarz), 1 for every free first state (Akaike: few samples
        know of it).
        """
        states = self._first_states() - base._first_states()
        return 0.5 * (len(self.parameters) - len(base.parameters)) * float(np.log(self.samples)) + states

    def _first_states(self) -> int:
        """How many first states were estimated, in all experiments."""
        return sum(slopes.shape[2] for slopes in self.by_states)


@dataclass(frozen=True)
class Rival:
    """What a structure has to come near, or is not followed further.

    `log_likelihood`; `errors`: root mean squares of the outputs' residuals, where those leave nothing but noise.
    """

    log_likelihood: float = -np.inf
    errors: FloatArray | None = None

    def cost(self, weights: FloatArray, residuals: Sequence[FloatArray]) -> float:
        """Weighted sum of squared residuals beyond which a simulation error is hopeless."""
        if self.errors is None:
            return np.inf
        count = np.sum([np.isfinite(r).sum(axis=0) for r in residuals], axis=0)
        return MUCH_WORSE * float(np.nansum(count * (weights * self.errors) ** 2))


NO_RIVAL = Rival()


def root_mean_squares(residuals: Sequence[FloatArray]) -> FloatArray:
    """Of each output's residuals, those of all experiments together; NaN where it was never measured."""
    stacked = np.concatenate(residuals)
    known = np.isfinite(stacked).sum(axis=0)
    return np.asarray(np.sqrt(np.nansum(stacked**2, axis=0) / np.where(known > 0, known, np.nan)))


def times_its_innovations(structure: Structure | Point) -> float:
    """How far a structure's simulation error stands above what its noise cannot predict of it, at the output where it is most."""
    return float(np.nanmax(times_each_its_innovations(structure)))


def times_each_its_innovations(structure: Structure | Point) -> FloatArray:
    """The same of each output; NaN where it was never measured."""
    return root_mean_squares(structure.residuals) / innovation_scales(structure.noises)


def innovation_scales(noises: Noises) -> FloatArray:
    """Standard deviation of each output's innovations; NaN where one is never measured."""
    return np.array([np.nan if noise is None else np.sqrt(noise.innovation_variance) for noise in noises])
