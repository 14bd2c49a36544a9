"""Compare a model with records: how large is its error, is it structured, and where does it lie?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.blas_threads import one_thread
from residuum.identification.errors import NotIdentifiable
from residuum.identification.physics import (
    Estimate,
    Experiment,
    PhysicalModel,
    Simulator,
    estimate,
    match,
)
from residuum.identification.physics.files.expression import Name, Node, walk
from residuum.identification.physics.simulate.kalman import Filter, Smoothed, tune
from residuum.identification.physics.simulate.record_checks import begins_elsewhere, leaves_tables
from residuum.identification.record import Record
from residuum.identification.residual_analysis.feedback import a_step_away, at_likelier_timing
from residuum.identification.residual_analysis.followed import check_followed
from residuum.identification.residual_analysis.locate import Axis, Region, regions, signal_axes
from residuum.identification.residual_analysis.noise import Floor, floor_under_drift, noise_floor
from residuum.identification.residual_analysis.odd_readings import (
    OddReadings,
    codes_of_inputs,
    odd_readings,
    without_odd,
)
from residuum.identification.residual_analysis.policy import (
    BEYOND_NOISE,
    HORIZONS,
    PREDICTED_SAMPLES,
    STRUCTURE_LEVEL,
    UNDER_STRUCTURE,
)
from residuum.identification.residual_analysis.structure_tests import (
    beyond_noise,
    refitted_difference,
    simulated_states,
    structured_errors,
    structured_in_windows,
)
from residuum.identification.residual_analysis.structured_error import StructuredError
from residuum.identification.residual_analysis.value_doubt import at_likeliest_values

# How large a model's errors are: of each output, simulated and predicted, and of each balance.


@dataclass(frozen=True)
class OutputError:
    """How one output is met: `rmse`, `bias`, `noise_floor` and the k-step errors in `unit`,
    `fit_percent` of the simulation.

    `noise_at_most` says that the noise is that or less: the error's own tail may be as large.
    `least_floor` is the least noise that any reading of the error gives: places are held against
    it. `k_step` maps a horizon in samples to the RMS error of predictions so far ahead.
    """

    unit: str
    rmse: float
    fit_percent: float
    bias: float
    noise_floor: float
    noise_at_most: bool
    least_floor: float
    k_step: Mapping[int, float]


@dataclass(frozen=True)
class BalanceError:
    """What one balance lacks: RMS of its smoothed missing term, in `unit` and relative to its
    driven terms.
    """

    unit: str
    missing_rms: float
    relative_percent: float


def output_errors(
    model: PhysicalModel,
    experiments: list[Experiment],
    simulation: Estimate,
    ahead: Mapping[int, FloatArray],
    structured: Mapping[str, StructuredError],
) -> dict[str, OutputError]:
    """Of each measured output; `ahead` are the errors of predictions, `structured` the tests that
    say what of it is noise.
    """
    by_output = {}
    for k, output in enumerate(model.outputs.values()):
        errors = [residual[:, k] for residual in simulation.residuals]
        error = np.concatenate(errors)
        known = np.isfinite(error)
        if not known.any():
            continue
        y = np.concatenate([e.Y[:, k] for e in experiments])[known]
        rmse = float(np.sqrt(np.mean(error[known] ** 2)))
        spread = float(np.sqrt(np.mean((y - y.mean()) ** 2)))
        floor, least = _floors(errors, rmse, structured.get(output.name))
        by_output[output.name] = OutputError(
            unit=output.unit,
            rmse=rmse,
            fit_percent=100.0 * (1.0 - rmse / spread) if spread > 0 else float("nan"),
            bias=float(np.mean(error[known])),
            noise_floor=floor.rms,
            noise_at_most=floor.at_most,
            least_floor=least,
            k_step={steps: float(errors_ahead[k]) for steps, errors_ahead in ahead.items()},
        )
    return by_output


def _floors(
    errors: Sequence[FloatArray], rmse: float, test: StructuredError | None
) -> tuple[Floor, float]:
    """The noise of an output as it is told, and the least that any reading of its error gives."""
    if test is not None and test.present:
        # a structured error reaches into the fast part, too: read under its tail, from higher up,
        # and by what the test leaves
        floor = floor_under_drift(errors)
        from_higher_up = noise_floor(errors, lowest=UNDER_STRUCTURE)
        return floor, min(from_higher_up, _unstructured(rmse, test), floor.rms)
    least = noise_floor(errors)
    # not structured, and near the noise of its fast part: all of it is noise
    if test is not None and rmse < BEYOND_NOISE * least:
        least = rmse
    return Floor(least, at_most=False), least


def _unstructured(rmse: float, test: StructuredError) -> float:
    """RMS of an error without its structured part, which the test knows from means over blocks:
    `noise_rms` is what they keep.
    """
    structured = test.noise_rms**2 * test.share / max(1.0 - test.share, 1e-300)
    return float(np.sqrt(max(rmse**2 - structured, test.noise_rms**2)))


def prediction_errors(
    kalman: Filter, experiments: list[Experiment], smoothed: list[Smoothed]
) -> dict[int, FloatArray]:
    """RMS error of each output predicted 1, 10 and 100 samples ahead, missing terms held at their
    last estimate.
    """
    by_horizon = {}
    for steps in HORIZONS:
        long_enough = [
            (e, s) for e, s in zip(experiments, smoothed, strict=True) if e.n > 2 * steps
        ]
        if not long_enough:
            continue
        errors = np.concatenate(
            [
                _ahead(kalman, e, s, steps, PREDICTED_SAMPLES // len(long_enough))
                for e, s in long_enough
            ]
        )
        count = np.isfinite(errors).sum(axis=0)
        by_horizon[steps] = np.sqrt(
            np.nansum(errors**2, axis=0) / np.where(count > 0, count, np.nan)
        )
    return by_horizon


def _ahead(
    kalman: Filter, experiment: Experiment, smoothed: Smoothed, steps: int, most: int
) -> FloatArray:
    """Prediction errors on a stretch from the record's middle, at most `most` samples and twice the
    horizon.
    """
    length = min(experiment.n, max(most, 2 * steps))
    start = (experiment.n - length) // 2
    part = experiment.window(start, start + length)
    filtered = smoothed.filtered[start : start + length]
    return part.Y - kalman.predict(part, replace(smoothed, filtered=filtered), steps)


def balance_errors(
    model: PhysicalModel, experiments: list[Experiment], smoothed: list[Smoothed]
) -> dict[str, BalanceError]:
    """Of each balance whose missing term was estimated."""
    simulator = Simulator(model)
    looks = [simulator.look(e, s.X) for e, s in zip(experiments, smoothed, strict=True)]
    by_balance = {}
    for name, balance in model.balances.items():
        terms = [s.missing[name].value for s in smoothed if name in s.missing]
        if not terms:
            continue
        rms = float(np.sqrt(np.mean(np.concatenate(terms) ** 2)))
        driven = [
            f"{name}.{term}"
            for term, value in balance.terms.items()
            if _is_driven(model, value.tree)
        ]
        # a balance that nothing drives has a drive of one sample of zero, and no relative error
        drive = np.concatenate(
            [sum((look[key] for key in driven), np.zeros(1)) * np.ones(1) for look in looks]
        )
        size = float(np.sqrt(np.mean(drive**2)))
        by_balance[name] = BalanceError(
            balance.unit, rms, 100.0 * rms / size if size > 0 else float("nan")
        )
    return by_balance


def _is_driven(model: PhysicalModel, tree: Node) -> bool:
    """Whether a term contains an input or a current."""
    currents = {b.variables["current"] for b in model.balances.values() if "current" in b.variables}
    return any(
        isinstance(node, Name) and node.name in {*model.inputs, *currents} for node in walk(tree)
    )


@dataclass(frozen=True, eq=False)
class Comparison:
    """A model held against records.

    `simulation` is the model with its parameters as they are and estimated initial states;
    `smoothed` has each balance's missing term with its band, one a record; `axes` are the signals
    along which errors were located, one list a record; `structured` is the structured-error test of
    each measured output; `driven_by_codes` says which inputs hold error codes.
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
    odd: tuple[OddReadings, ...] = ()
    driven_by_codes: tuple[str, ...] = ()

    @property
    def odd_samples(self) -> bool:
        """Whether samples that no sensor measured make most of an output's error, which no test of
        noise judges then.
        """
        for k, name in enumerate(self.model.outputs):
            odd = whole = 0.0
            for source, residuals in zip(self.records, self.simulation.residuals, strict=True):
                error = np.nan_to_num(residuals[:, k]) ** 2
                odd += float(error[self._odd_rows(name, source, len(error))].sum())
                whole += float(error.sum())
            if odd > 0.5 * whole:
                return True
        return False

    def _odd_rows(self, output: str, source: str, n: int) -> list[int]:
        """Of one output in one record of n samples, each once."""
        readings = [odd for odd in self.odd if (odd.output, odd.source) == (output, source)]
        return sorted({row for odd in readings for row in odd.rows if row < n})

    @property
    def present(self) -> bool:
        """Whether any output's error is structured."""
        return any(test.present for test in self.structured.values())

    @property
    def p_value(self) -> float:
        """Of "every output's error is noise of some colour" (Bonferroni over the outputs); 1 where
        no output could be tested.
        """
        return min(
            (1.0, *(len(self.structured) * test.p_value for test in self.structured.values()))
        )

    def times_noise(self, name: str) -> float:
        """RMS of the structured part of an output's error over the least that its noise can be;
        infinite without noise.
        """
        structured = self.outputs[name].rmse * max(self.structured[name].share, 0.0) ** 0.5
        floor = self.outputs[name].least_floor
        return structured / floor if floor > 0.0 else np.inf if structured > 0.0 else 0.0

    @property
    def warnings(self) -> tuple[str, ...]:
        """What of the model the records contradict before anything is simulated, and what a sensor
        says without a value.
        """
        says = (text for odd in self.odd for text in odd.says())
        before = (
            *begins_elsewhere(self.model, self.experiments),
            *leaves_tables(self.model, self.experiments),
        )
        return (*before, *says, *self.driven_by_codes)

    @property
    def not_recorded(self) -> dict[str, tuple[str, ...]]:
        """Outputs that were not compared, each with the records that have no value of it."""
        lacking = {
            name: tuple(
                source
                for source, e in zip(self.records, self.experiments, strict=True)
                if not e.measured[k]
            )
            for k, name in enumerate(self.model.outputs)
        }
        return {name: records for name, records in lacking.items() if records}

    @property
    def share(self) -> float:
        """Part of the residual's power that is structured, outputs weighted by their error in units
        of noise.
        """
        # an output that is met without any noise must not rule for its floor of zero
        times = np.array(
            [
                output.rmse / max(output.least_floor, 1e-12 * output.rmse, 1e-300)
                for output in (self.outputs[name] for name in self.structured)
            ]
        )
        shares = [test.share for test in self.structured.values()]
        return float(np.average(shares, weights=times**2)) if times.any() else 0.0


@one_thread()
def compare(
    model: PhysicalModel,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None = None,
    *,
    level: float = STRUCTURE_LEVEL,
    seed: int = 0,
    refuse_unstable: bool = True,
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
    refuse_unstable : bool
        Whether a model that is unstable along a record which its simulation leaves is refused; not
        where it was fitted before.

    Raises
    ------
    BadRecord, BadUnit
        Columns that do not fit the model.
    NotIdentifiable
        The model diverges on a record, or is unstable along it.
    """
    model, experiments = match(model, records, mapping)
    # before anything is judged: a code that no sensor measured would be most of the error
    experiments, odd = without_odd(model, experiments)
    try:
        experiments, simulation = at_likelier_timing(
            experiments, lambda turned: estimate(model, turned, free=()), a_step_away
        )
    except NotIdentifiable:
        if refuse_unstable:
            check_followed(model, experiments)
        raise
    if refuse_unstable:
        check_followed(model, experiments, simulation)
    kalman = Filter(model, tune(model, experiments, simulation.initial))
    runs = list(zip(experiments, simulation.initial, simulation.substeps, strict=True))
    smoothed = [kalman.run(e, x0, substeps=steps) for e, x0, steps in runs]
    axes = [
        signal_axes(model, run[0], simulated_states(model, *run), r)
        for run, r in zip(runs, records, strict=True)
    ]
    # values within their doubt are no structure, wrong ones are: the error is tested at the
    # likeliest values, and what a refit mends is one of the signals that may predict it
    refitted = refitted_difference(model, experiments, simulation)
    tested = at_likeliest_values(model, experiments, simulation)
    structured = structured_errors(
        experiments, tested, axes, model, refitted, level=level, seed=seed
    )
    # a plant that integrates is judged in windows; for any other what is too large for noise counts
    in_parts = structured_in_windows(model, experiments, structured, level, seed)
    structured |= in_parts or beyond_noise(
        model, experiments, simulation.residuals, axes, structured
    )
    ahead = prediction_errors(kalman, experiments, smoothed)
    outputs = output_errors(model, experiments, simulation, ahead, structured)
    smoothed_axes = [
        signal_axes(model, e, s.X, record)
        for e, s, record in zip(experiments, smoothed, records, strict=True)
    ]
    floors = {name: output.least_floor for name, output in outputs.items()}
    return Comparison(
        model=model,
        records=tuple(record.source for record in records),
        experiments=experiments,
        simulation=simulation,
        outputs=outputs,
        balances=balance_errors(model, experiments, smoothed),
        structured=structured,
        smoothed=smoothed,
        axes=smoothed_axes,
        odd=_beside(model, experiments, simulation, odd),
        driven_by_codes=codes_of_inputs(model, records, mapping),
        where=regions(
            model, experiments, simulation.residuals, smoothed, smoothed_axes, floors, structured
        ),
    )


def _beside(
    model: PhysicalModel,
    experiments: Sequence[Experiment],
    simulation: Estimate,
    left_out: Sequence[OddReadings],
) -> tuple[OddReadings, ...]:
    """What was left out, and what stands out of the rest beside the simulation."""
    simulated = [
        experiment.Y - residual
        for experiment, residual in zip(experiments, simulation.residuals, strict=True)
    ]
    return (*left_out, *odd_readings(model, experiments, simulated))
