"""Compare a model with records: how large is its error, is it structured, and where does it lie?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from residuum.identification.blas_threads import one_thread
from residuum.identification.discrepancy.axes import signal_axes
from residuum.identification.discrepancy.coloured_noise import forgetting, longest_memory
from residuum.identification.discrepancy.features import features
from residuum.identification.discrepancy.feedback import feeds_back
from residuum.identification.discrepancy.input_timing import at_likelier_timing
from residuum.identification.discrepancy.locate import Axis, Region
from residuum.identification.discrepancy.noise_floor import (
    CHANCE,
    PLAINLY,
    UNDER_STRUCTURE,
    fast_floor,
    noise_floor,
    times_the_noise,
)
from residuum.identification.discrepancy.prediction_windows import in_windows
from residuum.identification.discrepancy.regions import regions
from residuum.identification.discrepancy.structured_error import StructuredError, test_structured_error
from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.physics import Estimate, Experiment, PhysicalModel, Settings, Simulator, block_means, estimate, match
from residuum.identification.physics.files.expression import Name, Node, walk
from residuum.identification.physics.simulate.kalman import Filter, Smoothed, tune
from residuum.identification.record import Record

FloatArray = npt.NDArray[np.float64]

TEST_SAMPLES = 2000
_MENDED = 0.7
"""Ratio of the RMS errors after and before re-estimation below which the parameters' values err."""
_PREDICTED_SAMPLES = 2000
HORIZONS = (1, 10, 100)


@dataclass(frozen=True)
class OutputError:
    """How one output is met: `rmse`, `bias`, `noise_floor` and the k-step errors in `unit`, `fit_percent` of the simulation.

    `k_step` maps a horizon in samples to the RMS error of predictions so far ahead.
    """

    unit: str
    rmse: float
    fit_percent: float
    bias: float
    noise_floor: float
    k_step: Mapping[int, float]


@dataclass(frozen=True)
class BalanceError:
    """What one balance lacks: RMS of its smoothed missing term, in `unit` and relative to its driven terms."""

    unit: str
    missing_rms: float
    relative_percent: float


@dataclass(frozen=True, eq=False)
class Comparison:
    """A model held against records.

    `simulation` is the model with its parameters as they are and estimated initial states; `smoothed` has each balance's
    missing term with its band, one a record; `axes` are the signals along which errors were located, one list a record;
    `structured` is the structured-error test of each measured output.
    """

    model: PhysicalModel
    records: tuple[str, ...]
    experiments: list[Experiment]
    simulation: Estimate
    outputs: Mapping[str, OutputError]
    balances: Mapping[str, BalanceError]
    structured: Mapping[str, StructuredError]
    smoothed: list[Smoothed]
    axes: list[list[Axis]]
    where: tuple[Region, ...]

    @property
    def present(self) -> bool:
        """Whether any output's error is structured."""
        return any(test.present for test in self.structured.values())

    @property
    def p_value(self) -> float:
        """Of "every output's error is noise of some colour" (Bonferroni over the outputs)."""
        return min(1.0, len(self.structured) * min((test.p_value for test in self.structured.values()), default=1.0))

    @property
    def share(self) -> float:
        """Part of the residual's power that is structured, outputs weighted by their error in units of noise."""
        power = {name: (self.outputs[name].rmse / max(self.outputs[name].noise_floor, 1e-300)) ** 2 for name in self.structured}
        total = sum(power.values())
        return sum(power[name] * test.share for name, test in self.structured.items()) / total if total > 0 else 0.0


@one_thread()
def compare(
    model: PhysicalModel,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None = None,
    *,
    level: float = 0.01,
    seed: int = 0,
) -> Comparison:
    """Hold a model, its parameters as they are, against records.

    Parameters
    ----------
    model : PhysicalModel
    records : sequence of Record
        Each is an experiment with its own initial states.
    mapping : mapping of model name to column
    level : float
        False-alarm probability of the structured-error verdict.

    Raises
    ------
    BadRecord, BadUnit
        Columns that do not fit the model.
    NotIdentifiable
        The model diverges on a record.
    """
    model, experiments = match(model, records, mapping)
    experiments, simulation = at_likelier_timing(experiments, lambda turned: estimate(model, turned, free=()))
    kalman = Filter(model, tune(model, experiments, simulation.initial))
    runs = list(zip(experiments, simulation.initial, simulation.substeps, strict=True))
    smoothed = [kalman.run(e, x0, substeps=steps) for e, x0, steps in runs]
    axes = [signal_axes(model, run[0], _simulated_states(model, *run), r) for run, r in zip(runs, records, strict=True)]
    refitted = _refitted(model, experiments, simulation)
    structured = structured_errors(experiments, simulation.residuals, axes, model, refitted, level=level, seed=seed)
    in_parts = _structured_in_windows(model, experiments, structured, level, seed)
    structured |= in_parts or _plainly_structured(model, simulation.residuals, structured)
    ahead = _prediction_errors(kalman, experiments, smoothed)
    outputs = _output_errors(model, experiments, simulation, ahead, structured)
    seen = [signal_axes(model, e, s.X, record) for e, s, record in zip(experiments, smoothed, records, strict=True)]
    floors = {name: output.noise_floor for name, output in outputs.items()}
    return Comparison(
        model=model,
        records=tuple(record.source for record in records),
        experiments=experiments,
        simulation=simulation,
        outputs=outputs,
        balances=_balance_errors(model, experiments, smoothed),
        structured=structured,
        smoothed=smoothed,
        axes=seen,
        where=regions(model, experiments, simulation.residuals, smoothed, seen, floors, structured),
    )


def _refitted(model: PhysicalModel, experiments: list[Experiment], simulation: Estimate) -> list[FloatArray]:
    """What other values of the free parameters change in the outputs, (n, outputs) an experiment; 0 where that mends little.

    Noise is not mended by a few parameters; where they take away half of an error's power the model's values err, and this
    difference shows it even where (a resonance beside its place) no function of the simulated signals does.
    """
    nothing = [np.zeros_like(residual) for residual in simulation.residuals]
    try:
        other = estimate(model, experiments, initial=simulation.initial, settings=Settings(iterations=15, tolerance=1e-4))
    except NotIdentifiable:
        return nothing
    with np.errstate(invalid="ignore"):
        mended = np.nan_to_num(other.rmse / simulation.rmse, nan=1.0) < _MENDED
    pairs = zip(simulation.residuals, other.residuals, strict=True)
    return [np.where(mended & np.isfinite(before), before - after, 0.0) for before, after in pairs]


def structured_errors(
    experiments: Sequence[Experiment],
    residuals: Sequence[FloatArray],
    axes: Sequence[Sequence[Axis]],
    model: PhysicalModel,
    refitted: Sequence[FloatArray] | None = None,
    *,
    level: float = 0.01,
    seed: int = 0,
    least_share: float = 0.0,
) -> dict[str, StructuredError]:
    """The structured-error test of every measured output, on block means of about `TEST_SAMPLES` samples in all.

    Noise forgets within the data, for noise that is integrated would explain every slow error. Where a controller answers the
    noise (`feedback`), signals predict the error of the next sample, for in their own they know the noise; where blocks have
    several samples that of the next block but one, for in the block before they know how much of the noise came last, and is
    remembered. `refitted` (n, outputs) an experiment is what other parameter values would change, one more signal that may
    predict the error; the other arguments are those of `test_structured_error`.
    """
    how: dict[str, Any] = {"level": level, "seed": seed, "drifting": False, "least_share": least_share}
    total = sum(e.n for e in experiments)
    block = max(1, total // TEST_SAMPLES)
    every = [features(record_axes) for record_axes in axes]
    alive = np.any([np.any(design, axis=0) for design in every], axis=0)
    later = (1 if block == 1 else 2) * int(feeds_back(model, experiments, residuals))
    designs = [block_means(design[:, alive], block) for design in every]
    found = {}
    for k, name in enumerate(model.outputs):
        errors = [block_means(residual[:, k], block) for residual in residuals]
        changes = [block_means(change[:, k : k + 1], block) for change in refitted or ()]
        own = [np.hstack(pair) for pair in zip(designs, changes, strict=True)] if changes else designs
        known = [np.vstack([np.full((later, X.shape[1]), np.nan), X[: len(X) - later]]) for X in own]
        try:
            found[name] = test_structured_error(errors, known, **how)
        except BadInput:  # not measured, or too short a record for the test: no claim is made
            continue
    return found


def _structured_in_windows(
    model: PhysicalModel, experiments: list[Experiment], whole: Mapping[str, StructuredError], level: float, seed: int
) -> dict[str, StructuredError]:
    """The test on windows with first states of their own, of a plant that integrates; nothing for other plants.

    Over a whole record such a plant drifts with every small error, and the drift passes for noise that is integrated.
    """
    parts = in_windows(model, experiments)
    if len(parts) == len(experiments):
        return {}
    try:
        simulation = estimate(model, parts, free=())
    except NotIdentifiable:
        return {}
    runs = zip(parts, simulation.initial, simulation.substeps, strict=True)
    axes = [signal_axes(model, run[0], _simulated_states(model, *run)) for run in runs]
    refitted = _refitted(model, parts, simulation)
    found = structured_errors(parts, simulation.residuals, axes, model, refitted, level=level, seed=seed)
    found |= _plainly_structured(model, simulation.residuals, found)
    return {name: replace(test, predicted=whole[name].predicted) for name, test in found.items() if name in whole}


def _plainly_structured(
    model: PhysicalModel, residuals: Sequence[FloatArray], tested: Mapping[str, StructuredError]
) -> dict[str, StructuredError]:
    """The tests of those outputs whose error stands so far above the noise of its fast part that no noise gets there.

    Noise that is integrated would explain any slow error, and leave the test blind to the largest of them.
    """
    found = {}
    for k, name in enumerate(model.outputs):
        errors = [residual[:, k] for residual in residuals]
        times = times_the_noise(errors)
        if name in tested and times > PLAINLY:
            test, size = tested[name], sum(map(len, errors))
            noise = replace(test.noise, a=forgetting(test.noise.a, longest_memory(size, max(map(len, errors)))))
            p_value, share = min(test.p_value, CHANCE), max(test.share, 1.0 - 1.0 / times**2)
            floor = min(test.noise_rms, fast_floor(errors))
            found[name] = replace(test, present=True, p_value=p_value, share=share, noise_rms=floor, noise=noise)
    return found


def _simulated_states(model: PhysicalModel, experiment: Experiment, x0: FloatArray, substeps: int) -> FloatArray:
    simulator = Simulator(model)
    return simulator.run_vectors(experiment, x0, simulator.p(), substeps=substeps).X


def _output_errors(
    model: PhysicalModel,
    experiments: list[Experiment],
    simulation: Estimate,
    ahead: Mapping[int, FloatArray],
    structured: Mapping[str, StructuredError],
) -> dict[str, OutputError]:
    found = {}
    for k, output in enumerate(model.outputs.values()):
        errors = [residual[:, k] for residual in simulation.residuals]
        error = np.concatenate(errors)
        known = np.isfinite(error)
        if not known.any():
            continue
        y = np.concatenate([e.Y[:, k] for e in experiments])[known]
        rmse = float(np.sqrt(np.mean(error[known] ** 2)))
        spread = float(np.sqrt(np.mean((y - y.mean()) ** 2)))
        test = structured.get(output.name)
        if test is not None and test.present:
            floor = min(noise_floor(errors, lowest=UNDER_STRUCTURE), _unstructured(rmse, test))
        else:
            floor = noise_floor(errors)
            floor = rmse if test is not None and rmse < PLAINLY * floor else floor
        found[output.name] = OutputError(
            unit=output.unit,
            rmse=rmse,
            fit_percent=100.0 * (1.0 - rmse / spread) if spread > 0 else float("nan"),
            bias=float(np.mean(error[known])),
            noise_floor=floor,
            k_step={steps: float(errors_ahead[k]) for steps, errors_ahead in ahead.items()},
        )
    return found


def _unstructured(rmse: float, test: StructuredError) -> float:
    """RMS of an error without its structured part, which the test knows from means over blocks: `noise_rms` is what they keep."""
    structured = test.noise_rms**2 * test.share / max(1.0 - test.share, 1e-300)
    return float(np.sqrt(max(rmse**2 - structured, test.noise_rms**2)))


def _prediction_errors(kalman: Filter, experiments: list[Experiment], smoothed: list[Smoothed]) -> dict[int, FloatArray]:
    """RMS error of each output predicted 1, 10 and 100 samples ahead, missing terms held at their last estimate."""
    found = {}
    for steps in HORIZONS:
        long_enough = [(e, s) for e, s in zip(experiments, smoothed, strict=True) if e.n > 2 * steps]
        if not long_enough:
            continue
        errors = np.concatenate([_ahead(kalman, e, s, steps, _PREDICTED_SAMPLES // len(long_enough)) for e, s in long_enough])
        count = np.isfinite(errors).sum(axis=0)
        found[steps] = np.sqrt(np.nansum(errors**2, axis=0) / np.where(count > 0, count, np.nan))
    return found


def _ahead(kalman: Filter, experiment: Experiment, smoothed: Smoothed, steps: int, most: int) -> FloatArray:
    """Prediction errors on a stretch from the record's middle, at most `most` samples and twice the horizon."""
    length = min(experiment.n, max(most, 2 * steps))
    start = (experiment.n - length) // 2
    part, filtered = experiment.window(start, start + length), smoothed.filtered[start : start + length]
    return part.Y - kalman.predict(part, replace(smoothed, filtered=filtered), steps)


def _balance_errors(model: PhysicalModel, experiments: list[Experiment], smoothed: list[Smoothed]) -> dict[str, BalanceError]:
    simulator = Simulator(model)
    looks = [simulator.look(e, s.X) for e, s in zip(experiments, smoothed, strict=True)]
    found = {}
    for name, balance in model.balances.items():
        terms = [s.missing[name].value for s in smoothed if name in s.missing]
        if not terms:
            continue
        rms = float(np.sqrt(np.mean(np.concatenate(terms) ** 2)))
        driven = [f"{name}.{term}" for term, value in balance.terms.items() if _is_driven(model, value.tree)]
        drive = np.concatenate([sum((look[key] for key in driven), np.zeros(1)) * np.ones(1) for look in looks])
        size = float(np.sqrt(np.mean(drive**2)))
        found[name] = BalanceError(balance.unit, rms, 100.0 * rms / size if size > 0 else float("nan"))
    return found


def _is_driven(model: PhysicalModel, tree: Node) -> bool:
    """Whether a term contains an input or a current."""
    currents = {b.variables["current"] for b in model.balances.values() if "current" in b.variables}
    return any(isinstance(node, Name) and node.name in {*model.inputs, *currents} for node in walk(tree))
