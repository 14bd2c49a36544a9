"""Whether what a model leaves of its outputs is structured: by its own signals, by its size, or at
one place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.physics import (
    Estimate,
    Experiment,
    PhysicalModel,
    Simulator,
    block_means,
    estimate,
    windows,
)
from residuum.identification.physics.simulate.kalman import Filter, first_noise
from residuum.identification.residual_analysis.feedback import feeds_back
from residuum.identification.residual_analysis.lower_rate import at_lower_rate
from residuum.identification.residual_analysis.noise import (
    fast_floor,
    forgetting,
    longest_memory,
    times_the_noise,
)
from residuum.identification.residual_analysis.places.local_structure import (
    features,
    local_structure,
)
from residuum.identification.residual_analysis.places.locate import Axis, signal_axes
from residuum.identification.residual_analysis.policy import (
    BEYOND_NOISE,
    BEYOND_NOISE_CHANCE,
    COARSE_EVENNESS,
    COARSE_REPEATS,
    LASTING,
    LONGEST_PREDICTED,
    REVALUED,
    SHORTEST_PREDICTED,
    STRUCTURE_LEVEL,
    TEST_SAMPLES,
    VALUES_ERR,
    WINDOWS,
)
from residuum.identification.residual_analysis.structured_error import (
    StructuredError,
    test_structured_error,
)
from residuum.identification.residual_analysis.value_doubt import at_likeliest_values

# Outputs that are read in steps so coarse that most samples repeat the one before.


def reading_variances(experiments: Sequence[Experiment]) -> FloatArray:
    """q²/12 of each output that lies on stairs of step q and mostly repeats itself, 0 of the
    others, shape (outputs,).

    Between two steps such an output says nothing new. Its error would pass for noise that is nearly
    integrated, which no slow error of a model can be told from.
    """
    changes = np.concatenate([np.diff(e.Y, axis=0) for e in experiments])
    return np.array([_step(change) ** 2 / 12.0 for change in changes.T])


def _step(changes: FloatArray) -> float:
    """The smallest change, if most samples do not change and the others by whole numbers of it;
    else 0.
    """
    known = np.abs(changes[np.isfinite(changes)])
    moving = known[known > 0.0]
    if not moving.size or moving.size > (1.0 - COARSE_REPEATS) * known.size:
        return 0.0
    steps = moving / np.min(moving)
    return (
        float(np.min(moving)) if np.max(np.abs(steps - np.round(steps))) < COARSE_EVENNESS else 0.0
    )


# Plants that integrate are judged by prediction over windows, each with its own initial states.


def in_windows(
    model: PhysicalModel, experiments: Sequence[Experiment], finer: int = 1
) -> list[Experiment]:
    """The experiments, cut into windows where the outputs never forget an initial state, so many
    times `finer` than usual.

    Over a whole record the simulation of such a plant drifts with every small error of its input
    (and in closed loop with the controller's answer to the noise); over a window with states of its
    own it does not.

    States that no output feels (a position where only speed is measured) go on from window to
    window as the measurements track them: free in every window, they would let whatever depends on
    them differ from one to the next.
    """
    windowed: list[Experiment] = []
    for e in experiments:
        samples = int(np.clip(e.n // WINDOWS, SHORTEST_PREDICTED, LONGEST_PREDICTED)) // finer
        felt = _lasting(model, e) if e.n > 2 * samples else None
        if felt is None or not any(share > LASTING for share in felt.values()):
            windowed.append(e)
            continue
        unfelt = [name for name, share in felt.items() if share == 0.0]
        windowed += (
            _anchored(model, e, windows(e, samples), unfelt) if unfelt else windows(e, samples)
        )
    return windowed


def _anchored(
    model: PhysicalModel, experiment: Experiment, parts: list[Experiment], states: list[str]
) -> list[Experiment]:
    """The windows with these states known from the Kalman filter over the whole experiment."""
    simulator = Simulator(model)
    X = (
        Filter(model, first_noise(model, [experiment]))
        .run(experiment, simulator.x0(experiment.known))
        .X
    )
    if not np.all(np.isfinite(X)):
        return parts
    rows = [round((part.t0 - experiment.t0) / experiment.sample_time) for part in parts]
    columns = {name: simulator.states.index(name) for name in states}
    return [
        replace(part, known={name: float(X[row, k]) for name, k in columns.items()})
        for part, row in zip(parts, rows, strict=True)
    ]


def _lasting(model: PhysicalModel, experiment: Experiment) -> dict[str, float] | None:
    """For each free initial state how much of its peak effect on a measured output is there at the
    end; None if it diverges.
    """
    states = [
        name for name in model.states if name not in model.initial and name not in experiment.known
    ]
    simulator = Simulator(model)
    slopes = [f"initial:{name}" for name in states]
    run = simulator.run_vectors(experiment, simulator.x0(), simulator.p(), slopes=slopes)
    if not states or run.dY is None or not np.all(np.isfinite(run.dY)):
        return None
    size = np.abs(run.dY[:, experiment.measured])
    late, peak = size[-max(1, experiment.n // 10) :].mean(axis=0), size.max(axis=0)
    shares = np.divide(late, peak, out=np.zeros_like(late), where=peak > 0).max(axis=0)
    return dict(zip(states, shares.tolist(), strict=True))


def refitted_difference(
    model: PhysicalModel, experiments: list[Experiment], simulation: Estimate
) -> list[FloatArray]:
    """What other values of the free parameters change in the outputs, (n, outputs) an experiment; 0
    where that mends little.

    Noise is not mended by a few parameters; where they take away half of an error's power the
    model's values err, and this difference shows it even where (a resonance beside its place) no
    function of the simulated signals does.
    """
    nothing = [np.zeros_like(residual) for residual in simulation.residuals]
    try:
        coarse, step = at_lower_rate(model, experiments, simulation.initial)
        refit = estimate(model, coarse, initial=simulation.initial, settings=REVALUED)
        after = refit.residuals if step == 1 else _left(refit, experiments)
    except NotIdentifiable:
        return nothing
    with np.errstate(invalid="ignore"):
        mended = np.nan_to_num(_rms(after) / simulation.rmse, nan=1.0) < VALUES_ERR
    pairs = zip(simulation.residuals, after, strict=True)
    return [
        np.where(mended & np.isfinite(before), before - remaining, 0.0)
        for before, remaining in pairs
    ]


def _left(estimated: Estimate, experiments: Sequence[Experiment]) -> list[FloatArray]:
    """What an estimate at a lower rate leaves of each experiment at its own."""
    simulator = Simulator(estimated.model)
    p = simulator.p()
    substeps = simulator.substeps_each(experiments, estimated.initial, p)
    return simulator.run_each(experiments, estimated.initial, p, substeps=substeps).errors_of_each


def _rms(residuals: Sequence[FloatArray]) -> FloatArray:
    """Of each output; NaN where it was not measured."""
    joined = np.concatenate(residuals)
    count = np.isfinite(joined).sum(axis=0)
    return np.asarray(np.sqrt(np.nansum(joined**2, axis=0) / np.where(count > 0, count, np.nan)))


def structured_errors(
    experiments: Sequence[Experiment],
    residuals: Sequence[FloatArray],
    axes: Sequence[Sequence[Axis]],
    model: PhysicalModel,
    refitted: Sequence[FloatArray] | None = None,
    *,
    level: float = STRUCTURE_LEVEL,
    seed: int = 0,
    least_share: float = 0.0,
) -> dict[str, StructuredError]:
    """The structured-error test of every measured output, on block means of about `TEST_SAMPLES`
    samples in all.

    Noise forgets within the data, for noise that is integrated would explain every slow error.
    Where a controller answers the noise (`feedback`), signals predict the error of the next sample,
    for in their own they know the noise; where blocks have several samples that of the next block
    but one, for in the block before they know how much of the noise came last, and is remembered.
    `refitted` (n, outputs) an experiment is what other parameter values would change, one more
    signal that may predict the error; the other arguments are those of `test_structured_error`.
    """
    how: dict[str, Any] = {
        "level": level,
        "seed": seed,
        "drifting": False,
        "least_share": least_share,
    }
    total = sum(e.n for e in experiments)
    block = max(1, total // TEST_SAMPLES)
    every = [features(record_axes) for record_axes in axes]
    alive = np.any([np.any(design, axis=0) for design in every], axis=0)
    later = (1 if block == 1 else 2) * int(feeds_back(model, experiments, residuals))
    designs = [block_means(design[:, alive], block) for design in every]
    by_output = {}
    for k, name in enumerate(model.outputs):
        errors = [block_means(residual[:, k], block) for residual in residuals]
        changes = [block_means(change[:, k : k + 1], block) for change in refitted or ()]
        own = (
            [np.hstack(pair) for pair in zip(designs, changes, strict=True)] if changes else designs
        )
        known = [
            np.vstack([np.full((later, X.shape[1]), np.nan), X[: len(X) - later]]) for X in own
        ]
        try:
            by_output[name] = test_structured_error(errors, known, **how)
        except BadInput:  # not measured, or too short a record for the test: no claim is made
            continue
    return by_output


def structured_in_windows(
    model: PhysicalModel,
    experiments: list[Experiment],
    whole: Mapping[str, StructuredError],
    level: float,
    seed: int,
) -> dict[str, StructuredError]:
    """The test on windows with first states of their own, of a plant that integrates; nothing for
    other plants.

    Over a whole record such a plant drifts with every small error, and the drift passes for noise
    that is integrated.
    """
    parts = in_windows(model, experiments)
    if len(parts) == len(experiments):
        return {}
    try:
        simulation = estimate(model, parts, free=())
    except NotIdentifiable:
        return {}
    runs = zip(parts, simulation.initial, simulation.substeps, strict=True)
    axes = [signal_axes(model, run[0], simulated_states(model, *run)) for run in runs]
    refitted = refitted_difference(model, parts, simulation)
    tested = at_likeliest_values(model, parts, simulation)
    tests = structured_errors(parts, tested, axes, model, refitted, level=level, seed=seed)
    tests |= beyond_noise(model, parts, simulation.residuals, axes, tests)
    # The windows decide whether; how much of the error it is, is asked of the record that is
    # reported.
    return {
        name: replace(whole[name], present=test.present, p_value=test.p_value, noise=test.noise)
        for name, test in tests.items()
        if name in whole
    }


def beyond_noise(
    model: PhysicalModel,
    experiments: Sequence[Experiment],
    residuals: Sequence[FloatArray],
    axes: Sequence[Sequence[Axis]],
    tested: Mapping[str, StructuredError],
) -> dict[str, StructuredError]:
    """The tests of those outputs whose error is too large for noise: everywhere, or at one
    place.
    """
    hidden, by_output = reading_variances(experiments), {}
    for k, name in enumerate(model.outputs):
        if name not in tested:
            continue
        test, errors = tested[name], [residual[:, k] for residual in residuals]
        structured = _plainly_structured(errors, test)
        if structured is None and not test.present:
            structured = _locally_structured(errors, test, axes, float(np.sqrt(12.0 * hidden[k])))
        if structured is not None:
            by_output[name] = structured
    return by_output


def _plainly_structured(
    errors: Sequence[FloatArray], test: StructuredError
) -> StructuredError | None:
    """The test of an output whose error stands so far above the noise of its fast part that no
    noise gets there; None of others.

    Noise that is integrated would explain any slow error, and leave the test blind to the largest
    of them.
    """
    times = times_the_noise(errors)
    if not times > BEYOND_NOISE:
        return None
    noise = replace(
        test.noise,
        a=forgetting(test.noise.a, longest_memory(sum(map(len, errors)), max(map(len, errors)))),
    )
    p_value, share = min(test.p_value, BEYOND_NOISE_CHANCE), max(test.share, 1.0 - 1.0 / times**2)
    floor = min(test.noise_rms, fast_floor(errors))
    return replace(test, present=True, p_value=p_value, share=share, noise_rms=floor, noise=noise)


def _locally_structured(
    errors: Sequence[FloatArray], test: StructuredError, axes: Sequence[Sequence[Axis]], step: float
) -> StructuredError | None:
    """The test of an output whose error stands out at one place as noise does at none; None of
    others.
    """
    place = local_structure(errors, axes, step)
    if place is None or not place.present:
        return None
    share = max(test.share, 1.0 - 1.0 / place.times_noise**2)
    return replace(test, present=True, p_value=min(test.p_value, place.p_value), share=share)


def simulated_states(
    model: PhysicalModel, experiment: Experiment, x0: FloatArray, substeps: int
) -> FloatArray:
    """The states of a simulation from x0, shape (n, states)."""
    simulator = Simulator(model)
    return simulator.run_vectors(experiment, x0, simulator.p(), substeps=substeps).X
