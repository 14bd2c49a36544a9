"""Estimation of a model's parameters from records, each with its own initial states.

Minimises Σ over experiments, outputs and samples of (w·F(q)(y − ŷ(θ, x₀)))² by Levenberg–Marquardt
with exact sensitivities: θ are the free parameters, x₀ the initial states of each experiment, w =
1/σ the weight of an output, F an optional noise filter (an AR polynomial: the whitened residual of
coloured noise). The initial states of one experiment touch no other, so they are eliminated
blockwise (Schur complement) and thousands of experiments cost no more than their simulations.
Cutting a record into windows of k samples (`windows`) gives the k-step prediction error with free
states, which suits plants that integrate and data from a closed loop.

Bounds are kept by projection: a parameter at its bound with the gradient pointing out is held for
that step. Parameter covariance is σ²·H⁻¹ with H the Gauss–Newton matrix after elimination (Ljung,
*System Identification*, 9.4); an eigenvector of the scaled H with a vanishing eigenvalue is a *flat
direction*: the data cannot tell its members apart. A parameter's prior is one more row, (θ − μ)/σ
(`priors`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import scipy

from residuum.identification.descent import End, descend
from residuum.identification.errors import MAY_DIVERGE, NotIdentifiable
from residuum.identification.physics.estimation.least_squares import (
    FlatDirection,
    bounded_step,
    covariance_of,
    damped,
    solve_scaled,
)
from residuum.identification.physics.estimation.priors import Priors
from residuum.identification.physics.simulate.experiment import Experiment
from residuum.identification.physics.simulate.simulation import Runs, Simulator
from residuum.identification.work import count_fit

if TYPE_CHECKING:
    from residuum.identification.physics.model import PhysicalModel

Array = npt.NDArray[np.float64]

REWEIGHTINGS = 2
"""How often the outputs' weights are taken from the residuals anew."""
MOST_REWEIGHTINGS, _WEIGHED = 12, 1e-3
"""How often beside priors at most, and the relative change of a weight at which it is enough."""
_COARSE = 2.0
"""Times the steps a sample that were taken from which on those of a run are too few."""
_OPTIMISM = 3.0
"""Times what a step promises by which the cost may fall in all."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """The result of an estimation.

    Attributes
    ----------
    model : PhysicalModel
        With the estimated values.
    parameters : tuple of str
        Full names of the estimated parameters.
    theta, covariance : array
        Their values and covariance, shapes (q,) and (q, q); infinite variance along flat
        directions.
    initial : list of array
        Initial states of each experiment, in the kernel's order.
    predicted : list of array
        Simulated outputs, shape (n, outputs), one an experiment.
    residuals : list of array
        y − ŷ in the outputs' units (NaN where missing).
    cost : float
        Weighted (and filtered) sum of squares.
    samples : int
        Number of measured values used.
    flat : tuple of FlatDirection
    at_bound : tuple of str
    converged : bool
    substeps : tuple of int
        Integration steps a sample that were used.
    priors : Priors
        Of the parameters.
    of_records : mapping of name to (array, array)
        Parameters with a value for each record: their values and standard deviations, shape
        (experiments,) each.
    promised : float
        Part of the cost that a whole Gauss–Newton step from here promises: next to nothing in a
        minimum.
    """

    model: PhysicalModel
    parameters: tuple[str, ...]
    theta: Array
    covariance: Array
    initial: list[Array]
    predicted: list[Array]
    residuals: list[Array]
    weights: Array
    cost: float
    samples: int
    flat: tuple[FlatDirection, ...]
    at_bound: tuple[str, ...]
    converged: bool
    iterations: int
    substeps: tuple[int, ...]
    priors: Priors
    of_records: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)
    promised: float = 0.0

    @property
    def std(self) -> Array:
        """Standard deviations of the parameters, shape (q,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def rmse(self) -> Array:
        """Root mean square residual of each output (NaN where it was never measured), shape
        (outputs,).
        """
        stacked = np.concatenate(self.residuals)
        count = np.sum(np.isfinite(stacked), axis=0)
        return np.sqrt(np.nansum(stacked**2, axis=0) / np.where(count, count, np.nan))


@dataclass(frozen=True)
class Settings:
    """How to estimate.

    `weights`: 1/σ of each output (None: from the residuals, twice); `filters`: AR polynomials (1,
    a₁, …) of each output's noise; `iterations`: the most Gauss–Newton steps; `tolerance`: relative
    fall of the cost at which to stop; `blocks`: whether the means of the experiments' blocks are to
    be met rather than every sample; `rival`: a cost, of which a point that is not promised to come
    near it is left.
    """

    weights: Array | None = None
    filters: Sequence[Array] | None = None
    iterations: int = 40
    tolerance: float = 1e-8
    blocks: bool = False
    rival: float = np.inf


def windows(experiment: Experiment, samples: int) -> list[Experiment]:
    """The experiment in windows of `samples`, each to be given its own initial states (a rest under
    half is dropped).
    """
    starts = range(0, experiment.n, samples)
    # Each window is a record with first states of its own, known only where the record begins.
    cut = [experiment.window(start, min(start + samples, experiment.n)) for start in starts]
    return [part for part in cut if part.n >= max(2, samples // 2)]


def estimate(
    model: PhysicalModel,
    experiments: Sequence[Experiment],
    *,
    free: Sequence[str] | None = None,
    initial: Sequence[Array] | None = None,
    settings: Settings = Settings(),
    substeps: Sequence[int] | None = None,
) -> Estimate:
    """Estimate free parameters and initial states by (filtered) simulation error.

    Parameters
    ----------
    free : sequence of str
        Full names; default: the model's free parameters.
    initial : sequence of array
        First values of the states, one vector an experiment in kernel order; default:
        `first_states`.
    substeps : sequence of int
        Integration steps a sample of each experiment; default: as many as its first simulation asks
        for.

    Raises
    ------
    NotIdentifiable
        No measured output, or the model diverges at its starting values already.
    """
    if not experiments or not any(e.measured.any() for e in experiments):
        raise NotIdentifiable(
            f"model {model.name!r}: no output of it was measured; there is nothing to estimate from"
        )
    count_fit()
    names = tuple(model.free if free is None else free)
    problem = SimulationErrorProblem(Simulator(model), list(experiments), names, settings)
    start = [np.array(x) for x in initial] if initial is not None else problem.first_states()
    return problem.solve(start, substeps)


def _end_to_end(experiments: Sequence[Experiment]) -> Experiment:
    """One with the rows of all, for sums over them."""
    U = np.concatenate([e.U for e in experiments])
    Y = np.concatenate([e.Y for e in experiments])
    return replace(experiments[0], U=U, Y=Y, known={})


@dataclass
class _Point:
    theta: Array
    initial: list[Array]
    predicted: list[Array]
    gradient: Array
    hessian: Array
    cross: list[Array]
    own: list[Array]
    own_gradient: list[Array]
    cost: float


class SimulationErrorProblem:
    """One least-squares problem: evaluates cost and Gauss–Newton blocks, and walks down."""

    def __init__(
        self,
        simulator: Simulator,
        experiments: list[Experiment],
        names: tuple[str, ...],
        settings: Settings,
    ) -> None:
        self.simulator = simulator
        self.experiments = experiments
        self.names = names
        self.settings = settings
        parameters = simulator.model.all_parameters
        self.lower = np.array([parameters[name].lower for name in names])
        self.upper = np.array([parameters[name].upper for name in names])
        self.theta0 = np.array([parameters[name].value for name in names])
        self.priors = Priors.of(parameters, names)
        self.index = simulator.columns(names)
        # Where everything about first states is known there is nothing to eliminate: one sum over
        # all experiments saves a loop.
        self.states = () if self._all_known(simulator.free_states) else simulator.free_states
        self.summed = (
            self.experiments if self.states or len(experiments) == 1 else [_end_to_end(experiments)]
        )
        self.state_index = [simulator.states.index(name) for name in self.states]
        self.slopes = [*names, *(f"initial:{name}" for name in self.states)]
        self.measured = np.any([e.measured for e in experiments], axis=0)
        self.substeps = [0] * len(experiments)
        self._kept: tuple[object, Runs] | None = None
        # An output that no experiment measured has no weight.
        self.weights = np.where(self.measured, 1.0, 0.0)

    def _all_known(self, states: Sequence[str]) -> bool:
        """Whether nothing is free that belongs to one experiment alone: then the sums may run over
        all of them at once.
        """
        settings = self.settings
        known = all(name in e.known for e in self.experiments for name in states)
        return (
            known
            and settings.filters is None
            and not (settings.blocks and any(e.block > 1 for e in self.experiments))
        )

    def _runs(self, initial: list[Array], p: Array, slopes: Sequence[str] = ()) -> Runs:
        """Simulations of the experiments that are summed over.

        The last ones are kept where they take long: weights change more often than values.
        """
        # Bytes, not values: two vectors are the same run only to the last bit.
        key = (p.tobytes(), *(x.tobytes() for x in initial), *slopes, *self.substeps)
        if self._kept is not None and self._kept[0] == key:
            return self._kept[1]
        runs = self.simulator.run_each(
            self.experiments, initial, p, slopes=slopes, substeps=self.substeps
        )
        if self.summed is not self.experiments:
            runs = replace(runs, experiments=self.summed, starts=runs.starts[[0, -1]])
        # Only such runs take long: each is a call of a library. Others are cheaper than what would
        # be kept.
        if self.simulator.model.foreign is not None:
            self._kept = (key, runs)
        return runs

    def first_states(self) -> list[Array]:
        """Initial states at zero (or as the model fixes them), then fitted to the beginning of each
        record.
        """
        starts = [self.simulator.measured_start(experiment) for experiment in self.experiments]
        p = self.p(self.theta0)
        self.substeps = self.simulator.substeps_each(self.experiments, starts, p)
        self.weights = self._scales()
        # Three steps: outputs are not linear in first values.
        for _ in range(3):
            for number, x0 in enumerate(starts):
                starts[number] = self._fit_states(number, x0, p)
        return starts

    def _fit_states(self, number: int, x0: Array, p: Array) -> Array:
        """One Gauss–Newton step of the initial states alone, over the whole record, kept when it
        helps.
        """
        if not self.states:
            return x0

        def run(x: Array, slopes: Sequence[str]) -> Runs:
            return self.simulator.run_each(
                [self.experiments[number]], [x], p, slopes=slopes, substeps=[self.substeps[number]]
            )

        # Slopes by the states alone: the parameters are held here.
        before = run(x0, self.slopes[len(self.names) :])
        if not before.bounded:
            return x0
        ((r, J),) = self._weighted(before)
        if J is None:
            return x0
        step = solve_scaled(J.T @ J, (J.T @ r)[:, None])[:, 0]
        trial = x0.copy()
        trial[self.state_index] += step
        after = run(trial, ())
        if not after.bounded:
            return x0
        ((r_there, _),) = self._weighted(after)
        # A step that makes it worse is not taken; there is no damping here, the descent has it.
        return trial if r_there @ r_there < r @ r else x0

    def _scales(self) -> Array:
        spread = np.nanstd(
            np.concatenate([e.Y for e in self.experiments])[:, self.measured], axis=0
        )
        # 1/spread makes outputs of any units comparable before anything is known of their noise.
        weights = np.zeros(self.measured.size)
        weights[self.measured] = 1.0 / np.where(spread > 0, spread, 1.0)
        return weights

    def p(self, theta: Array) -> Array:
        """All parameters in the kernel's order."""
        p = self.simulator.p()
        p[self.index] = theta
        return p

    def solve(self, initial: list[Array], substeps: Sequence[int] | None = None) -> Estimate:
        """Walk down from the model's values and these first states; `substeps` where they are
        known.
        """
        self.substeps = list(
            self.simulator.substeps_each(self.experiments, initial, self.p(self.theta0))
            if substeps is None
            else substeps
        )
        point, iterations, converged = self._walked(initial)
        # Steps that the caller gave are those of a comparison: every candidate takes the same.
        if substeps is None and self._too_coarse(point):
            point, used, converged = self._walked(initial)
            iterations += used
        return self._result(point, iterations, converged)

    def _too_coarse(self, point: _Point) -> bool:
        """Whether the runs that were found ask for many more steps a sample than the first ones
        did; those are taken from now on.

        A stop or a valve that the first run never reaches is stiff where it is met, and coarse
        steps leave it for anywhere.
        """
        needed = self.simulator.modal_substeps(self.experiments, point.initial, self.p(point.theta))
        if not any(n > _COARSE * have for n, have in zip(needed, self.substeps, strict=True)):
            return False
        self.substeps = [max(pair) for pair in zip(needed, self.substeps, strict=True)]
        return True

    def _walked(self, initial: list[Array]) -> tuple[_Point, int, bool]:
        """The lowest point from the model's values and these first states; weights are those of the
        residuals unless given.
        """
        given = self.settings.weights
        self.weights = self._scales() if given is None else np.where(self.measured, given, 0.0)
        point = self.point((self.theta0, initial))
        if not np.isfinite(point.cost):
            raise NotIdentifiable(
                f"model {self.simulator.model.name!r}: diverges at its starting values;"
                f" {MAY_DIVERGE}"
            )
        point, iterations, converged = self._descend(point)
        # Iterated: the weights are 1/RMS of the residuals, which follow from the weights.
        for _ in range(self._reweightings()):
            before = self.weights
            self.weights = self._from_residuals(point)
            # Beside priors the absolute size of the weights counts, so they have to settle;
            # without, only their ratios do.
            if self.priors.count and np.allclose(self.weights, before, rtol=_WEIGHED):
                break
            point, used, converged = self._descend(self.point((point.theta, point.initial)))
            iterations += used
        if given is None:
            self.weights = self._from_residuals(point)
            point = self.point((point.theta, point.initial))
        return point, iterations, converged

    def _reweightings(self) -> int:
        """How often at most: one output is weighed against priors alone, whose weight does not
        follow.
        """
        if self.settings.weights is not None:
            return 0
        return (
            MOST_REWEIGHTINGS
            if self.priors.count
            else REWEIGHTINGS * int(np.sum(self.measured) > 1)
        )

    def _from_residuals(self, point: _Point) -> Array:
        stacked = np.concatenate(
            [e.Y - y for e, y in zip(self.summed, point.predicted, strict=True)]
        )[:, self.measured]
        # A model that meets an output exactly would give it an infinite weight.
        floor = 1e-9 / self._scales()[self.measured]
        weights = np.zeros(self.measured.size)
        weights[self.measured] = 1.0 / np.maximum(np.sqrt(np.nanmean(stacked**2, axis=0)), floor)
        return weights

    def _descend(self, point: _Point) -> tuple[_Point, int, bool]:
        if not self.slopes:
            return point, 0, True
        point, steps, end = descend(
            self, point, steps=self.settings.iterations, relative=self.settings.tolerance
        )
        return point, steps, end in (End.SETTLED, End.STUCK)

    def ends(self, point: _Point) -> End | None:
        """Left where it is not promised to come near the rival."""
        rival = self.settings.rival
        return (
            End.LEFT
            if rival < np.inf and point.cost - _OPTIMISM * self._promised(point) > rival
            else None
        )

    def eliminated(self, point: _Point, damping: float) -> tuple[Array, Array, Array]:
        """Curvature and gradient of the parameters with the initial states eliminated, damped; and
        what those follow from.
        """
        cross = np.array(point.cross)
        wanted = np.concatenate(
            [cross.swapaxes(1, 2), np.array(point.own_gradient)[:, :, None]], axis=2
        )
        # H_xx⁻¹ (H_xθ, g_x) of each experiment: its own states' best answer (Schur complement).
        eliminated = solve_scaled(damped(np.array(point.own), damping), wanted)
        # What first states take off curvature and gradient: a parameter that they imitate keeps
        # little of either.
        absorbed = np.einsum("kqm,kmc->qc", cross, eliminated)
        return (
            damped(point.hessian, damping) - absorbed[:, :-1],
            point.gradient - absorbed[:, -1],
            eliminated,
        )

    def _promised(self, point: _Point) -> float:
        """By how much the cost falls with the whole step, if the outputs go on as they begin to."""
        H, g, eliminated = self.eliminated(point, 0.0)
        # gᵀH⁻¹g of the whole system, in its two parts.
        own = sum(float(b @ z[:, -1]) for b, z in zip(point.own_gradient, eliminated, strict=True))
        return own + float(g @ solve_scaled(H, g[:, None])[:, 0])

    def trial(self, point: _Point, damping: float) -> tuple[Array, list[Array]]:
        """Parameters and first states after the damped Gauss–Newton step, initial states
        eliminated, parameters within bounds.
        """
        H, g, eliminated = self.eliminated(point, damping)
        step = bounded_step(H, g, point.theta, self.lower, self.upper)
        # Rounding may lead past a bound by its last digit.
        theta = np.clip(point.theta + step, self.lower, self.upper)
        moved = theta - point.theta
        if not self.states:
            return theta, point.initial
        initial = []
        for x0, solved in zip(point.initial, eliminated, strict=True):
            x = x0.copy()
            # The states' answer to their own gradient, less what the move of the parameters takes
            # of it.
            x[self.state_index] += solved[:, -1] - solved[:, :-1] @ moved
            initial.append(x)
        return theta, initial

    def point(self, trial: tuple[Array, list[Array]]) -> _Point:
        """Cost, and the blocks that the next step needs."""
        theta, initial = trial
        q = len(self.names)
        runs = self._runs(initial, self.p(theta), self.slopes)
        pull = self.priors.pull(theta)
        precision = np.diag(self.priors.precisions)
        cost = self.priors.cost(theta)
        point = _Point(theta, initial, [], pull, precision, [], [], [], cost)
        # Infinite: the descent takes it for a step too far, and damps.
        if not runs.bounded:
            point.cost = np.inf
            return point
        point.predicted = [run.Y for run in runs]
        for r, J in self._weighted(runs):
            point.cost += float(r @ r)
            if J is not None:
                H = J.T @ J
                g = J.T @ r
                point.hessian += H[:q, :q]
                point.gradient += g[:q]
                point.cross.append(H[:q, q:])
                point.own.append(H[q:, q:])
                point.own_gradient.append(g[q:])
        return point

    def cost(self, trial: tuple[Array, list[Array]]) -> float:
        """The cost alone, which needs no sensitivities."""
        theta, initial = trial
        runs = self._runs(initial, self.p(theta))
        return (
            float(sum(r @ r for r, _ in self._weighted(runs))) + self.priors.cost(theta)
            if runs.bounded
            else np.inf
        )

    def _weighted(self, runs: Runs) -> list[tuple[Array, Array | None]]:
        """Weighted, filtered residuals of each experiment, those of all outputs in one, and their
        Jacobian; 0 where missing.
        """
        blocks = runs.in_blocks if self.settings.blocks else lambda values: (values, runs.starts)
        errors, starts = blocks(runs.errors)
        known = np.isfinite(errors)
        # An output without weight has no rows.
        known[:, ~self.measured] = False
        # Rows of zeros count nothing in the sums, and keep their places for the filters.
        r = np.where(known, errors, 0.0) * self.weights
        J = None if runs.dY is None else blocks(runs.dY)[0] * self.weights[:, None]
        if not self.slopes:  # nothing is estimated: a model without states and free parameters
            J = np.zeros((*r.shape, 0))
        if J is not None and not known.all():
            J[~known] = 0.0
        weighted: list[tuple[Array, Array | None]] = []
        for a, b in pairwise(starts.tolist()):
            valid = known[a:b]
            errors = self._filtered(r[a:b], valid).ravel()
            weighted.append(
                (
                    errors,
                    (
                        None
                        if J is None
                        else self._filtered(J[a:b], valid).reshape(errors.size, J.shape[-1])
                    ),
                )
            )
        return weighted

    def _filtered(self, signals: Array, known: npt.NDArray[np.bool_]) -> Array:
        """Signals (n, outputs, …), each output through its filter."""
        if self.settings.filters is None:
            return signals
        filtered = np.zeros_like(signals)
        for o in map(int, np.flatnonzero(self.measured)):
            filtered[:, o] = scipy.signal.lfilter(
                self.settings.filters[o], [1.0], signals[:, o], axis=0
            )
        # A filter carries neighbours into a missing sample: that row was not measured.
        filtered[~known] = 0.0
        return filtered

    def _of_records(
        self, point: _Point, covariance: Array, variance: float
    ) -> dict[str, tuple[Array, Array]]:
        """Values and standard deviations of the parameters that each record has for itself.

        With H_xx the curvature of an experiment's own values and H_θx that between, the covariance
        of the former is σ² H_xx⁻¹ + E cov(θ) Eᵀ, E = H_xx⁻¹ H_xθ: what the experiment tells, and
        what it takes over from the common parameters.
        """
        states = self.simulator.model.states
        numbers = {
            name: k
            for k, name in enumerate(self.states)
            if name in states and states[name].of_record is not None
        }
        if not numbers:
            return {}
        own = np.array(point.own)
        cross = np.array(point.cross).swapaxes(1, 2)
        identity = np.broadcast_to(np.eye(len(self.states)), own.shape)
        E = solve_scaled(own, cross)
        spread = variance * solve_scaled(own, identity) + E @ covariance @ E.swapaxes(1, 2)
        stds = np.sqrt(np.diagonal(spread, axis1=1, axis2=2))
        values = np.array(point.initial)[:, self.state_index]
        return {name: (values[:, k], stds[:, k]) for name, k in numbers.items()}

    def _result(self, point: _Point, iterations: int, converged: bool) -> Estimate:
        cross = np.array(point.cross)
        # Without damping: the covariance of the parameters, first states free.
        reduced = point.hessian - np.einsum(
            "kqm,kmc->qc", cross, solve_scaled(np.array(point.own), cross.swapaxes(1, 2))
        )
        samples = sum(int(np.sum(np.isfinite(e.Y[:, self.measured]))) for e in self.experiments)
        unknowns = len(self.names) + len(self.experiments) * len(self.states)
        # σ² of a weighted residual, by the degrees of freedom that are left.
        variance = point.cost / max(samples + self.priors.count - unknowns, 1)
        covariance, flat = covariance_of(reduced, variance, self.names, point.theta)
        model = self.simulator.model.with_values(
            dict(zip(self.names, point.theta.tolist(), strict=True))
        )
        # Not within a tolerance: the active set puts values on their bound exactly.
        bound = (point.theta <= self.lower) | (point.theta >= self.upper)
        ends = np.cumsum([e.n for e in self.experiments])[:-1]
        # Summed experiments come apart again: residuals are told of each record.
        predicted = np.split(np.concatenate(point.predicted), ends)
        return Estimate(
            model=model,
            parameters=self.names,
            theta=point.theta,
            covariance=covariance,
            initial=point.initial,
            predicted=predicted,
            residuals=[e.Y - y for e, y in zip(self.experiments, predicted, strict=True)],
            weights=self.weights,
            cost=point.cost,
            samples=samples,
            flat=flat,
            at_bound=tuple(
                name for name, is_at_bound in zip(self.names, bound, strict=True) if is_at_bound
            ),
            converged=converged,
            iterations=iterations,
            substeps=tuple(self.substeps),
            priors=self.priors,
            of_records=self._of_records(point, covariance, variance),
            promised=self._promised(point) / max(point.cost, 1e-300) if self.slopes else 0.0,
        )
