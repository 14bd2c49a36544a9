"""Whether what a model leaves of its outputs is structured: by its own signals, by its size, or at
one place.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.special import chdtrc

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.linear_models.recursive_filter import all_pole
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
from residuum.identification.residual_analysis.locate import Axis, signal_axes
from residuum.identification.residual_analysis.lower_rate import at_lower_rate
from residuum.identification.residual_analysis.noise import (
    fast_floor,
    fit_coloured_noise,
    forgetting,
    longest_memory,
    stretches,
    times_the_noise,
)
from residuum.identification.residual_analysis.policy import (
    BEYOND_NOISE,
    BEYOND_NOISE_CHANCE,
    BINS_OF_AN_AXIS,
    COARSE_EVENNESS,
    COARSE_REPEATS,
    COUNTED_IN_A_PLACE,
    FEWEST_FOR_A_PLACE,
    LASTING,
    LOCAL_LEVEL,
    LOCAL_OUTLIER,
    LOCAL_TIMES_NOISE,
    LONGEST_PREDICTED,
    NOISE_ORDER,
    REVALUED,
    SHORTEST_PREDICTED,
    SIGNAL_MEMORIES,
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

# Features: simple functions of a model's noise-free signals that a structured error may follow.

Shape = Callable[[FloatArray], FloatArray]


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
    smallest = float(np.min(moving))
    steps = moving / smallest
    is_even = np.max(np.abs(steps - np.round(steps))) < COARSE_EVENNESS
    return smallest if is_even else 0.0


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
        lasting = _lasting(model, e) if e.n > 2 * samples else None
        if lasting is None or not any(share > LASTING for share in lasting.values()):
            windowed.append(e)
            continue
        parts = windows(e, samples)
        unfelt = [name for name, share in lasting.items() if share == 0.0]
        windowed += _anchored(model, e, parts, unfelt) if unfelt else parts
    return windowed


def _anchored(
    model: PhysicalModel, experiment: Experiment, parts: list[Experiment], states: list[str]
) -> list[Experiment]:
    """The windows with these states known from the Kalman filter over the whole experiment."""
    simulator = Simulator(model)
    kalman = Filter(model, first_noise(model, [experiment]))
    X = kalman.run(experiment, simulator.x0(experiment.known)).X
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
        # whether a few values mend half of the error shows at any rate that loses nothing
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
    block = max(1, sum(e.n for e in experiments) // TEST_SAMPLES)
    known_late = 1 if block == 1 else 2
    later = known_late if feeds_back(model, experiments, residuals) else 0
    designs = _designs(axes, block)
    by_output = {}
    for k, name in enumerate(model.outputs):
        errors = [block_means(residual[:, k], block) for residual in residuals]
        own = designs if refitted is None else _beside(designs, refitted, k, block)
        try:
            by_output[name] = test_structured_error(
                errors,
                [_delayed(design, later) for design in own],
                level=level,
                seed=seed,
                drifting=False,
            )
        except BadInput:  # not measured, or too short a record for the test: no claim is made
            continue
    return by_output


def _designs(axes: Sequence[Sequence[Axis]], block: int) -> list[FloatArray]:
    """Means over blocks of the features of every record, (blocks, q) a record."""
    every = [features(record_axes) for record_axes in axes]
    # a signal that rests in all records has columns of zeros, which would count as features; one
    # that moves in one record alone keeps its columns in all
    alive = np.any([np.any(design, axis=0) for design in every], axis=0)
    return [block_means(design[:, alive], block) for design in every]


def _beside(
    designs: Sequence[FloatArray], refitted: Sequence[FloatArray], output: int, block: int
) -> list[FloatArray]:
    """The features and what other parameter values would change in an output."""
    changes = [block_means(change[:, output : output + 1], block) for change in refitted]
    return [np.hstack(pair) for pair in zip(designs, changes, strict=True)]


def _delayed(design: FloatArray, blocks: int) -> FloatArray:
    """Features so many blocks later; NaN where nothing went before."""
    before = np.full((blocks, design.shape[1]), np.nan)
    return np.vstack([before, design[: len(design) - blocks]])


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


# What the signals say of an error: everywhere, by functions of them, and at one place.
#
# Noise of any colour has innovations that are alike at all places (near standstill, at one end of
# the travel, after a step). So their mean square in a bin of a signal (speed, position, input,
# temperature, time) is that of all times χ²(n)/n. A bin far above that, in which the error itself
# stands far above that of the quiet half of the record, is structure.


def _smooth_sign(z: FloatArray) -> FloatArray:
    return np.tanh(z / 0.03)


_ODD: tuple[Shape, ...] = (
    lambda z: z,
    _smooth_sign,
    lambda z: z * np.abs(z),
    lambda z: z * np.exp(-((z / 0.15) ** 2)),
    np.abs,
)
_SMOOTH: tuple[Shape, ...] = (lambda z: z, np.square, lambda z: z**3)
_SHAPES: Mapping[str, tuple[Shape, ...]] = {
    "velocity": _ODD,
    "current": _ODD[:3],
    "input": (*_ODD[:3], np.square),
    "position": (*_SMOOTH, lambda z: np.sin(2 * np.pi * z), lambda z: np.cos(2 * np.pi * z)),
    "temperature": _SMOOTH,
    "level": (*_SMOOTH, lambda z: np.sqrt(np.abs(z))),
}


def features(axes: Sequence[Axis]) -> FloatArray:
    """Shapes of every axis that has some for its kind, each through three first-order lags, and a
    constant; shape (n, q).

    Signals are scaled by their largest magnitude first, so a shape means the same for every unit.
    """
    n = axes[0].values.shape[0]
    columns = [np.ones(n)]
    for axis in axes:
        largest = float(np.nanmax(np.abs(axis.values), initial=0.0))
        # what rests has columns too: it may move in another record
        scaled = np.nan_to_num(axis.values) / (largest or 1.0)
        columns += [
            _lagged(shape(scaled), pole)
            for shape in _SHAPES.get(axis.kind, ())
            for pole in SIGNAL_MEMORIES
        ]
    return np.stack(columns, axis=1)


def _lagged(x: FloatArray, pole: float) -> FloatArray:
    return x if pole == 0 else all_pole([1.0, -pole], (1.0 - pole) * x)


@dataclass(frozen=True)
class LocalStructure:
    """Where the error stands out most: `axis`, from `low` to `high`, `times_noise` there, and the
    p-value of all places.
    """

    axis: str
    low: float
    high: float
    times_noise: float
    p_value: float

    @property
    def present(self) -> bool:
        """Whether noise does not stand there."""
        return self.p_value < LOCAL_LEVEL and self.times_noise > LOCAL_TIMES_NOISE


def local_structure(
    residuals: Sequence[FloatArray], axes: Sequence[Sequence[Axis]], step: float = 0.0
) -> LocalStructure | None:
    """The place where one output's error stands out most; None where the records are too short or
    their quiet half has no noise.

    Parameters
    ----------
    residuals : sequence of arrays, shapes (n_r,)
        Measured minus modelled output, one array a record; NaN where missing.
    axes : sequence of sequence of Axis
        The signals of each record, the same in all.
    step : float
        The step of a coarse reading: noise that it hides is no larger.

    Notes
    -----
    Fails where noise itself depends on the place (a reading that gets coarser with speed); blind to
    what is spread evenly.
    """
    known = [np.isfinite(r) for r in residuals]
    r = _where_known(residuals, known)
    if r.size < FEWEST_FOR_A_PLACE:
        return None
    # spreads by medians (1.4826 = 1/Φ⁻¹(¾)): those of the quiet half, whatever the rest does
    quiet = max(1.4826 * float(np.median(np.abs(r - np.median(r)))), step / np.sqrt(12.0))
    innovations = _innovations(residuals, known)
    usual = 1.4826 * float(np.median(np.abs(innovations)))
    if quiet <= 0.0 or usual <= 0.0:
        return None
    error = np.clip(r - np.median(r), -LOCAL_OUTLIER * quiet, LOCAL_OUTLIER * quiet) ** 2
    power = np.clip(innovations, -LOCAL_OUTLIER * usual, LOCAL_OUTLIER * usual) ** 2
    places = []
    names = [axis.name for axis in axes[0]]
    for k, name in enumerate(names):
        values = _where_known([record_axes[k].values for record_axes in axes], known)
        loudest = _loudest_place(power, error, values, BINS_OF_AN_AXIS * len(names))
        if loudest is not None:
            low, high, p_value, mean = loudest
            times_noise = float(np.sqrt(mean)) / quiet
            places.append(LocalStructure(name, low, high, times_noise, p_value))
    return max(places, key=_telling, default=None)


def _where_known(
    signals: Sequence[FloatArray], known: Sequence[npt.NDArray[np.bool_]]
) -> FloatArray:
    """Signals of all records end to end, at the samples that are there."""
    return np.concatenate([signal[finite] for signal, finite in zip(signals, known, strict=True)])


def _telling(place: LocalStructure) -> tuple[bool, float]:
    """Places where noise does not stand before others, the loudest first."""
    certain = place.p_value < LOCAL_LEVEL
    return certain, place.times_noise if certain else -place.p_value


def _loudest_place(
    power: FloatArray, error: FloatArray, values: FloatArray, looks: int
) -> tuple[float, float, float, float] | None:
    """(from, to, p-value of the innovations' `power`, mean square `error`) of the bin that stands
    out most; None where the signal does not move.
    """
    edges = np.unique(
        np.quantile(values[np.isfinite(values)], np.linspace(0.0, 1.0, BINS_OF_AN_AXIS + 1))
    )
    if len(edges) < 3:
        return None
    place = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
    count = np.bincount(place, minlength=len(edges) - 1).astype(float)
    loud, mean = (
        np.bincount(place, z, minlength=len(edges) - 1) / np.maximum(count, 1.0)
        for z in (power, error)
    )
    freedom = np.maximum(count * COUNTED_IN_A_PLACE, 1.0)
    # Bonferroni: the p-value of the least likely of all bins that are looked at
    chance = np.minimum(chdtrc(freedom, freedom * loud / float(power.mean())) * looks, 1.0)
    chance[count == 0] = 1.0
    # of several places where noise does not stand the one with the largest error is told
    certain = chance < LOCAL_LEVEL
    largest = np.argmax(np.where(certain, mean, -1.0)) if np.any(certain) else np.argmin(chance)
    worst = int(largest)
    return float(edges[worst]), float(edges[worst + 1]), float(chance[worst]), float(mean[worst])


def _innovations(
    residuals: Sequence[FloatArray], known: Sequence[npt.NDArray[np.bool_]]
) -> FloatArray:
    """What each sample's past does not predict of it, sample by sample of those that are there; 0
    where nothing went before.
    """
    parts = [
        residual[part]
        for residual, finite in zip(residuals, known, strict=True)
        for part in stretches(finite)
    ]
    noise = fit_coloured_noise(parts, min(NOISE_ORDER, max(map(len, parts)) // 20))
    padded = []
    for part in parts:
        e = noise.whiten(part)
        padded.append(np.concatenate([np.zeros(len(part) - len(e)), e]))
    return np.concatenate(padded)
