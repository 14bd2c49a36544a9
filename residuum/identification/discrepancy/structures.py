"""Structures: a model with some effects, re-estimated together with the colour of its noise, and how likely the data are then.

Each output's residual v is autoregressive, A(q) v = e, with coefficients of its own *in every structure*: what remains of
a complete model is its noise, what remains of an incomplete one is noise plus the error, and comparing the likelihood of the
innovations e compares the two without ever assuming white noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.ascent import CLOSE, Ascent, Point
from residuum.identification.discrepancy.innovations import Noises
from residuum.identification.discrepancy.whitened_least_squares import NormalEquations
from residuum.identification.errors import NotIdentifiable
from residuum.identification.physics import Estimate, Experiment, PhysicalModel, Settings, Simulator, estimate
from residuum.identification.physics.model import find_effect

FloatArray = npt.NDArray[np.float64]

VISIBLE_SUBSTEPS = 16
"""An effect so fast that it asks for more of them, a tenth of a sample and less, cannot be seen in the record."""
_TOKEN, _NEAR_TOKEN = 1e-9, 1e3
"""Positive lower bounds up to which they only keep a parameter from zero, and times such a bound up to which it lies on it."""
COARSER = 2
"""Factor by which an integration may be coarser where it serves a first look alone (a Runge–Kutta step errs by 3e-4)."""
_EARLIER = 2.0
"""Log-likelihood from which on an effect is put before the others of its path."""
NOISE_ALONE = 1.2
"""Times its innovations (1.12 where both are white and normal) up to which an error is noise that swallowed nothing."""
_MUCH_WORSE = 4.0
"""A mean square simulation error that is not promised to come within this factor of its rival's is not followed further."""


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
    def log_likelihood(self) -> float:
        """Of the innovations at the estimate."""
        return float(self.pointwise.sum())

    @property
    def samples(self) -> int:
        """Number of innovations."""
        return int(self.pointwise.size)

    def label_of(self, key: tuple[str, str]) -> str:
        """Label of the effect that the candidate (id, target) became in this model."""
        return next(use.label for use in self.model.effects if (use.id, use.target) == key)

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
        return _MUCH_WORSE * float(np.nansum(count * (weights * self.errors) ** 2))


NO_RIVAL = Rival()


def fit_structure(
    model: PhysicalModel,
    experiments: Sequence[Experiment],
    initial: Sequence[FloatArray],
    *,
    free: Sequence[str] | None = None,
    iterations: int = 30,
    noises: Noises | None = None,
    rival: Rival = NO_RIVAL,
    second_start: bool = True,
    drifting: bool = False,
    most_substeps: float = np.inf,
) -> Structure | None:
    """Re-estimate a model and the colour of its noise together; None when the model diverges.

    `free` are the parameters to estimate (default: all that the model does not fix), `noises` holds the noise where it is known,
    a structure that will clearly not come near its `rival` is left where that is seen. None too where the model begins with more
    than `most_substeps` integration steps a sample.

    The likelihood has two basins: noise nearly integrated, which swallows a slow error together with what would mend it, and
    noise as it is with the error mended. The climb therefore begins twice, at the given point and at the least simulation error
    from there, and the likelier end is kept; but once where there is to be no `second_start`, or where the first end leaves noise
    alone that nothing swallowed.
    """
    names = tuple(model.free if free is None else free)
    ascent = Ascent(model, experiments, names, noises, drifting)
    start = _states(initial, ascent.simulator)
    if not ascent.choose_steps(start, most_substeps):
        return None
    first = ascent.point(ascent.simulator.p(), start)
    found = None if first is None else ascent.climb(first, iterations, rival.log_likelihood)
    if second_start and noises is None and not (found is not None and times_its_innovations(found) < NOISE_ALONE):
        plain = _least_simulation_error(ascent, model, start, None if found is None else found.residuals, rival)
        other = None if plain is None else ascent.point(ascent.simulator.p(plain.model.values), plain.initial)
        if other is not None and found is not None:
            other = ascent.climb(other, iterations, max(rival.log_likelihood, found.log_likelihood))
        if found is None or (other is not None and other.log_likelihood > found.log_likelihood):
            found = other
    if found is None:
        return None
    theta = found.p[ascent.index]
    token = (ascent.lower > 0.0) & (ascent.lower <= _TOKEN)
    bound = (theta <= np.where(token, _NEAR_TOKEN * ascent.lower, ascent.lower)) | (theta >= ascent.upper)
    equations = NormalEquations.of(found.residuals, found.by_parameters, found.by_states, found.noises)
    return Structure(
        model=model.with_values(dict(zip(names, theta.tolist(), strict=True))),
        parameters=names,
        std=equations.std(),
        initial=found.initial,
        substeps=ascent.substeps,
        residuals=found.residuals,
        by_parameters=found.by_parameters,
        by_states=found.by_states,
        noises=found.noises,
        reading=ascent.reading,
        pointwise=found.pointwise,
        rmse=found.rmse,
        at_bound=tuple(name for name, there in zip(names, bound, strict=True) if there),
        drifting=drifting,
    )


def refit(
    before: Structure,
    model: PhysicalModel,
    experiments: Sequence[Experiment],
    *,
    initial: Sequence[FloatArray] | None = None,
    rival: Rival = NO_RIVAL,
) -> Structure | None:
    """A model with one effect more or less re-estimated from where the structure `before` was, its noise drifting as there.

    None where it diverges, and where it is too fast to be seen. Where nothing but noise was left, what will not be worth its
    parameters is not followed further.
    """
    return fit_structure(
        model,
        experiments,
        before.initial if initial is None else initial,
        rival=replace(rival, log_likelihood=max(rival.log_likelihood, _worth_its_parameters(before, model))),
        drifting=before.drifting,
        most_substeps=visible(before),
    )


def _worth_its_parameters(before: Structure, model: PhysicalModel) -> float:
    """Log-likelihood that a model with more parameters has to come near where the structure `before` leaves nothing but noise."""
    more = len(model.free) - len(before.parameters)
    if more <= 0 or times_its_innovations(before) > NOISE_ALONE:
        return -np.inf
    return before.log_likelihood + CLOSE + 0.5 * more * float(np.log(before.samples))


def visible(before: Structure) -> int:
    """Most integration steps a sample that an effect on top of a structure may ask for."""
    return max(VISIBLE_SUBSTEPS, *before.substeps)


def in_likelier_order(structure: Structure, key: tuple[str, str], experiments: Sequence[Experiment]) -> Structure:
    """The structure with this effect before the others of its input or output path, where that is likelier.

    A path's stages do not commute: an offset before a limit is not one after it.
    """
    effects = structure.model.effects
    stages = [use for use in effects if use.target == key[1]]
    if find_effect(key[0]).place == "balance" or len(stages) < 2 or (stages[0].id, stages[0].target) == key:
        return structure
    moved = next(use for use in stages if use.id == key[0])
    model = replace(structure.model, effects=(moved, *(use for use in effects if use is not moved)))
    other = fit_structure(model, experiments, structure.initial, drifting=structure.drifting)
    return structure if other is None or other.log_likelihood < structure.log_likelihood + _EARLIER else other


def glimpse(
    model: PhysicalModel, experiments: Sequence[Experiment], before: Structure, most_substeps: int, rival: Rival = NO_RIVAL
) -> float:
    """Log-likelihood after a few steps down the simulation error from the structure `before`; −∞ when it diverges or is too fast.

    A cheap second opinion on candidates that a first-order test misjudges, because they switch (friction at a reversal) on a
    trajectory that the base model gets wrong. Left early where its error is not promised to come near its `rival`'s.
    """
    ascent = Ascent(model, experiments, tuple(model.free), None, before.drifting)
    start = _states(before.initial, ascent.simulator)
    if not ascent.choose_steps(start, most_substeps, before.substeps):
        return -np.inf
    ascent.substeps = tuple(-(-s // COARSER) for s in ascent.substeps)
    plain = _least_simulation_error(ascent, model, start, before.residuals, rival, iterations=4)
    return -np.inf if plain is None else ascent.log_likelihood(ascent.simulator.p(plain.model.values), plain.initial)


def _states(initial: Sequence[FloatArray], simulator: Simulator) -> list[FloatArray]:
    """Initial states in the simulator's order, from those of a model with an effect more or less.

    A new effect's own begin without deviation from what its kernel sets, and all effects' own where one was taken out.
    """
    states, model = simulator.states, len(simulator.model.states)
    kept = np.array([k < model or name in simulator.kernel.deviating for k, name in enumerate(states)])
    long = [x if len(x) <= len(states) else x[:model] for x in initial]
    return [np.where(kept, np.concatenate([x, np.zeros(len(states) - len(x))]), 0.0) for x in long]


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
    innovations = [np.nan if noise is None else np.sqrt(noise.innovation_variance) for noise in structure.noises]
    return root_mean_squares(structure.residuals) / np.array(innovations)


def _weights(residuals: Sequence[FloatArray]) -> FloatArray:
    """1/RMS of each output's residual; 0 where it was never measured."""
    return np.nan_to_num(1.0 / np.maximum(root_mean_squares(residuals), 1e-150))


def _least_simulation_error(
    ascent: Ascent,
    model: PhysicalModel,
    start: list[FloatArray],
    residuals: Sequence[FloatArray] | None,
    rival: Rival,
    iterations: int = 8,
) -> Estimate | None:
    """Where the plain simulation error is smallest, found in a few steps from the start; None when the model diverges.

    The outputs count in units of the `residuals` that are known.
    """
    settings = Settings(iterations=iterations, tolerance=1e-3, blocks=True)
    if residuals is not None:
        weights = _weights(residuals)
        settings = replace(settings, weights=weights, rival=rival.cost(weights, residuals))
    try:
        return estimate(model, ascent.experiments, free=ascent.names, initial=start, settings=settings, substeps=ascent.substeps)
    except NotIdentifiable:
        return None


def plain_estimate(model: PhysicalModel, experiments: Sequence[Experiment]) -> Estimate:
    """The model at the least simulation error, found roughly: white noise, whose basin is wide."""
    return estimate(model, experiments, settings=Settings(iterations=15, tolerance=1e-5))


def base_structure(model: PhysicalModel, experiments: Sequence[Experiment], plain: Estimate | None = None) -> Structure:
    """The model as it is, its free parameters, initial states and noise colours re-estimated from the `plain` estimate on.

    Raises
    ------
    NotIdentifiable
        The model diverges on a record.
    """
    first = plain_estimate(model, experiments) if plain is None else plain
    structure = fit_structure(first.model, experiments, first.initial, second_start=False)
    if structure is None:
        raise NotIdentifiable(f"model {model.name!r}: diverges on its records")
    return structure
