"""Estimation of a model's parameters by the likelihood of the extended Kalman filter's innovations.

For plants that integrate and for data from a closed loop: the filter follows the record, so drift
of a simulation does not enter, and each balance's unknown random-walk term absorbs what the model
lacks instead of bending its parameters. Minimises −log L = ½ Σ (e²/V + log 2πV) over θ by
Gauss–Newton steps on the normalised innovations e/√V (their derivatives by forward differences),
alternating with maximum likelihood of the noise (`kalman.tune`).

Reference: T. Bohlin, *Practical Grey-box Process Identification*, Springer 2006; N. R. Kristensen,
H. Madsen, S. B. Jørgensen, Automatica 40 (2004) 225.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from residuum.identification.descent import End, descend
from residuum.identification.physics.estimation.estimation import Estimate, Settings, estimate
from residuum.identification.physics.estimation.least_squares import (
    bounded_step,
    covariance_of,
    damped,
    solve_scaled,
)
from residuum.identification.physics.estimation.priors import Priors
from residuum.identification.physics.simulate.experiment import Experiment
from residuum.identification.physics.simulate.kalman import Filter, Noise, first_noise, tune
from residuum.identification.physics.simulate.simulation import Simulator

if TYPE_CHECKING:
    from residuum.identification.physics.model import PhysicalModel

Array = npt.NDArray[np.float64]

# Noise and parameters in turn: each is found with the other held. Most end earlier, where no value
# moves by 1e-4.
ROUNDS = 3
STEPS = 12
_ENOUGH = 1e-3  # of log L


def estimate_by_likelihood(
    model: PhysicalModel, experiments: Sequence[Experiment], *, free: Sequence[str] | None = None
) -> Estimate:
    """Estimate free parameters by the filter's likelihood; initial states are the filter's, started
    wide.

    The result's `predicted` and `residuals` are those of the simulation with the estimated
    parameters and refitted initial states; its covariance is that of the likelihood.

    Raises
    ------
    NotIdentifiable
        As `estimate`.
    """
    names = tuple(model.free if free is None else free)
    start = estimate(model, experiments, free=())
    likelihood = _Likelihood(model, list(experiments), names, start.initial)
    theta = np.array([model.values[name] for name in names])
    converged = False
    iterations = 0
    # The noise first, at these values; then values at that noise.
    for _ in range(ROUNDS):
        likelihood.tune(theta)
        reached, used, end = descend(likelihood, likelihood.point(theta), steps=STEPS, fall=_ENOUGH)
        moved = reached.theta
        converged = end in (End.SETTLED, End.STUCK)
        iterations += used
        settled = bool(np.all(np.abs(moved - theta) <= 1e-4 * np.maximum(np.abs(moved), 1e-12)))
        theta = moved
        if settled:
            break
    last = likelihood.point(theta)
    # Variance 1: innovations are normalised, so H is already that of log L.
    covariance, flat = covariance_of(last.hessian, 1.0, names, theta)
    final = model.with_values(dict(zip(names, theta.tolist(), strict=True)))
    # Told are simulations: a filter's predictions follow the record whatever the model lacks.
    simulated = estimate(final, experiments, free=(), initial=start.initial, settings=Settings())
    bound = (theta <= likelihood.lower) | (theta >= likelihood.upper)
    return replace(
        simulated,
        model=final,
        parameters=names,
        theta=theta,
        covariance=covariance,
        flat=flat,
        at_bound=tuple(name for name, reached in zip(names, bound, strict=True) if reached),
        priors=likelihood.priors,
        converged=converged,
        iterations=iterations,
        promised=_promised(last) / max(simulated.samples, 1),
    )


def _promised(point: _Point) -> float:
    """By how much −2 log L falls with the whole step."""
    return float(point.descent @ solve_scaled(point.hessian, point.descent[:, None])[:, 0])


@dataclass(frozen=True, eq=False)
class _Point:
    theta: Array
    cost: float
    hessian: Array
    descent: Array


class _Likelihood:
    """The negative log likelihood of the innovations as a function of the parameters."""

    def __init__(
        self,
        model: PhysicalModel,
        experiments: list[Experiment],
        names: tuple[str, ...],
        initial: list[Array],
    ) -> None:
        self.model = model
        self.experiments = experiments
        self.names = names
        self.initial = initial
        parameters = model.all_parameters
        self.lower = np.array([parameters[name].lower for name in names])
        self.upper = np.array([parameters[name].upper for name in names])
        self.priors = Priors.of(parameters, names)
        simulator = Simulator(model)
        self.substeps = simulator.substeps_each(experiments, initial, simulator.p())
        self.noise: Noise = first_noise(model, experiments)

    def at(self, theta: Array) -> PhysicalModel:
        return self.model.with_values(dict(zip(self.names, theta.tolist(), strict=True)))

    def tune(self, theta: Array) -> None:
        self.noise = tune(self.at(theta), self.experiments, self.initial)

    def innovations(self, theta: Array) -> tuple[Array, float]:
        """Normalised innovations of all experiments, stacked, and −log L."""
        kalman = Filter(self.at(theta), self.noise)
        parts = []
        cost = 0.0
        for experiment, x0, steps in zip(
            self.experiments, self.initial, self.substeps, strict=True
        ):
            run = kalman.run(experiment, x0, substeps=steps, smooth=False)
            # One experiment that diverges makes the whole impossible.
            if not np.isfinite(run.log_likelihood):
                return np.zeros(0), np.inf
            parts.append((run.innovations / np.sqrt(run.variances))[np.isfinite(run.innovations)])
            cost -= run.log_likelihood
        return np.concatenate(parts), cost

    def slopes(self, theta: Array, innovations: Array) -> Array:
        """Jacobian of the innovations by forward differences (backward at an upper bound)."""
        J = np.zeros((innovations.size, theta.size))
        for k in range(theta.size):
            # Forward differences: a filter run a parameter. The filter has no sensitivities of its
            # own.
            step = 1e-5 * max(abs(theta[k]), 1e-6)
            # Beyond a bound there may be no model.
            step = -step if theta[k] + step > self.upper[k] else step
            moved, cost = self.innovations(theta + step * (np.arange(theta.size) == k))
            # Towards a model that diverges nothing is known of the slope: no step goes there.
            J[:, k] = (moved - innovations) / step if np.isfinite(cost) else 0.0
        return J

    def point(self, trial: Array) -> _Point:
        """−log L there, and the Gauss–Newton matrix and gradient of the innovations."""
        innovations, cost = self.innovations(trial)
        J = self.slopes(trial, innovations) if np.isfinite(cost) else np.zeros((0, trial.size))
        curvature = J.T @ J + np.diag(self.priors.precisions)
        descent = self.priors.pull(trial) - J.T @ innovations
        return _Point(trial, cost + 0.5 * self.priors.cost(trial), curvature, descent)

    def cost(self, trial: Array) -> float:
        """−log L of the data and the priors."""
        return self.innovations(trial)[1] + 0.5 * self.priors.cost(trial)

    def trial(self, point: _Point, damping: float) -> Array:
        """The damped step, within bounds."""
        step = bounded_step(
            damped(point.hessian, damping), point.descent, point.theta, self.lower, self.upper
        )
        return np.clip(point.theta + step, self.lower, self.upper)

    def ends(self, point: _Point) -> End | None:
        """Nothing ends it but the likelihood itself."""
        return None
