"""Structures re-estimated: from a model, from another structure with an effect more or less, or by a few steps as a glimpse."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.fitting.ascent import Ascent, Point
from residuum.identification.discrepancy.fitting.structures import (
    NO_RIVAL,
    Rival,
    Structure,
    root_mean_squares,
    times_its_innovations,
)
from residuum.identification.discrepancy.fitting.whitened_least_squares import NormalEquations
from residuum.identification.discrepancy.policy.likelihood import (
    CLIMB_STEPS,
    CLOSE,
    COARSER,
    GLIMPSE_STEPS,
    HIGHER,
    NEAR_A_TOKEN,
    ROUGH,
    SECOND_START,
    TOKEN_BOUND,
    VISIBLE_SUBSTEPS,
)
from residuum.identification.errors import MAY_DIVERGE, NotIdentifiable
from residuum.identification.physics import Estimate, Experiment, Key, PhysicalModel, Simulator, estimate
from residuum.identification.physics.model import find_effect
from residuum.identification.residual_analysis.policy.noise import NOISE_ALONE

FloatArray = npt.NDArray[np.float64]


def fit_structure(
    model: PhysicalModel,
    experiments: Sequence[Experiment],
    initial: Sequence[FloatArray],
    *,
    iterations: int = CLIMB_STEPS,
    rival: Rival = NO_RIVAL,
    second_start: bool = True,
    drifting: bool = False,
    most_substeps: float = np.inf,
) -> Structure | None:
    """Re-estimate a model and the colour of its noise together; None when the model diverges.

    Estimated is what the model does not fix. A structure that will clearly not come near its `rival` is left where that is seen.
    None too where the model begins with more than `most_substeps` integration steps a sample.

    The likelihood has two basins: noise nearly integrated, which swallows a slow error together with what would mend it, and
    noise as it is with the error mended. The climb therefore begins twice, at the given point and at the least simulation error
    from there, and the likelier end is kept; but once where there is to be no `second_start`, or where the first end leaves noise
    alone that nothing swallowed.
    """
    ascent = Ascent(model, experiments, drifting)
    start = _states(initial, ascent.simulator)
    if not ascent.choose_steps(start, most_substeps):
        return None
    first = ascent.point(ascent.simulator.p(), start)
    found = None if first is None else ascent.climb(first, iterations, rival.log_likelihood)
    if second_start and (found is None or not times_its_innovations(found) < NOISE_ALONE):
        found = _climbed_again(ascent, start, found, iterations, rival)
    return None if found is None else _structure_at(found, ascent)


def _climbed_again(ascent: Ascent, start: list[FloatArray], found: Point | None, iterations: int, rival: Rival) -> Point | None:
    """The likelier of what was `found` and of the climb that begins at the least simulation error; None where both diverge."""
    plain = _least_simulation_error(ascent, start, None if found is None else found.residuals, rival)
    other = None if plain is None else ascent.point(ascent.simulator.p(plain.model.values), plain.initial)
    if other is None or found is None:
        return found or other
    other = ascent.climb(other, iterations, max(rival.log_likelihood, found.log_likelihood))
    return other if other.log_likelihood > found.log_likelihood else found


def _structure_at(found: Point, ascent: Ascent) -> Structure:
    """The structure that a climb ended at."""
    names, theta = ascent.names, found.p[ascent.index]
    token = (ascent.lower > 0.0) & (ascent.lower <= TOKEN_BOUND)
    bound = (theta <= np.where(token, NEAR_A_TOKEN * ascent.lower, ascent.lower)) | (theta >= ascent.upper)
    equations = NormalEquations.of(found.residuals, found.by_parameters, found.by_states, found.noises)
    return Structure(
        model=ascent.simulator.model.with_values(dict(zip(names, theta.tolist(), strict=True))),
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
        drifting=ascent.drifting,
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


def in_likelier_order(structure: Structure, key: Key, experiments: Sequence[Experiment]) -> Structure:
    """The structure with this effect before the others of its input or output path, where that is likelier.

    A path's stages do not commute: an offset before a limit is not one after it.
    """
    effects = structure.model.effects
    stages = [use for use in effects if use.target == key[1]]
    if find_effect(key[0]).place == "balance" or len(stages) < 2 or stages[0].key == key:
        return structure
    moved = next(use for use in stages if use.id == key[0])
    model = replace(structure.model, effects=(moved, *(use for use in effects if use is not moved)))
    other = fit_structure(model, experiments, structure.initial, drifting=structure.drifting)
    return structure if other is None or other.log_likelihood < structure.log_likelihood + HIGHER else other


def glimpse(
    model: PhysicalModel, experiments: Sequence[Experiment], before: Structure, most_substeps: int, rival: Rival = NO_RIVAL
) -> float:
    """Log-likelihood after a few steps down the simulation error from the structure `before`; −∞ when it diverges or is too fast.

    A cheap second opinion on candidates that a first-order test misjudges, because they switch (friction at a reversal) on a
    trajectory that the base model gets wrong. Left early where its error is not promised to come near its `rival`'s.
    """
    ascent = Ascent(model, experiments, before.drifting)
    start = _states(before.initial, ascent.simulator)
    if not ascent.choose_steps(start, most_substeps, before.substeps):
        return -np.inf
    ascent.substeps = tuple(-(-s // COARSER) for s in ascent.substeps)
    plain = _least_simulation_error(ascent, start, before.residuals, rival, GLIMPSE_STEPS)
    return -np.inf if plain is None else ascent.log_likelihood(ascent.simulator.p(plain.model.values), plain.initial)


def _states(initial: Sequence[FloatArray], simulator: Simulator) -> list[FloatArray]:
    """Initial states in the simulator's order, from those of a model with an effect more or less.

    A new effect's own begin without deviation from what its kernel sets, and all effects' own where one was taken out.
    """
    states, model = simulator.states, len(simulator.model.states)
    kept = np.array([k < model or name in simulator.kernel.deviating for k, name in enumerate(states)])
    long = [x if len(x) <= len(states) else x[:model] for x in initial]
    return [np.where(kept, np.concatenate([x, np.zeros(len(states) - len(x))]), 0.0) for x in long]


def _weights(residuals: Sequence[FloatArray]) -> FloatArray:
    """1/RMS of each output's residual; 0 where it was never measured."""
    return np.nan_to_num(1.0 / np.maximum(root_mean_squares(residuals), 1e-150))


def _least_simulation_error(
    ascent: Ascent,
    start: list[FloatArray],
    residuals: Sequence[FloatArray] | None,
    rival: Rival,
    iterations: int = SECOND_START.iterations,
) -> Estimate | None:
    """Where the plain simulation error is smallest, found in a few steps from the start; None when the model diverges.

    The outputs count in units of the `residuals` that are known.
    """
    settings = replace(SECOND_START, iterations=iterations)
    if residuals is not None:
        weights = _weights(residuals)
        settings = replace(settings, weights=weights, rival=rival.cost(weights, residuals))
    try:
        return estimate(
            ascent.simulator.model,
            ascent.experiments,
            free=ascent.names,
            initial=start,
            settings=settings,
            substeps=ascent.substeps,
        )
    except NotIdentifiable:
        return None


def plain_estimate(model: PhysicalModel, experiments: Sequence[Experiment]) -> Estimate:
    """The model at the least simulation error, found roughly: white noise, whose basin is wide."""
    return estimate(model, experiments, settings=ROUGH)


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
        raise NotIdentifiable(f"model {model.name!r}: diverges on its records; {MAY_DIVERGE}")
    return structure
