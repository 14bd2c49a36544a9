"""How large a model's errors are: of each output, simulated and predicted, and of each balance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.physics import Estimate, Experiment, PhysicalModel, Simulator
from residuum.identification.physics.files.expression import Name, Node, walk
from residuum.identification.physics.simulate.kalman import Filter, Smoothed
from residuum.identification.residual_analysis.noise.noise_floor import Floor, floor_under_drift, noise_floor
from residuum.identification.residual_analysis.policy.answers import HORIZONS, PREDICTED_SAMPLES
from residuum.identification.residual_analysis.policy.noise import BEYOND_NOISE, UNDER_STRUCTURE
from residuum.identification.residual_analysis.structured_error import StructuredError


@dataclass(frozen=True)
class OutputError:
    """How one output is met: `rmse`, `bias`, `noise_floor` and the k-step errors in `unit`, `fit_percent` of the simulation.

    `noise_at_most` says that the noise is that or less: the error's own tail may be as large. `least_floor` is the least noise
    that any reading of the error gives: places are held against it. `k_step` maps a horizon in samples to the RMS error of
    predictions so far ahead.
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
    """What one balance lacks: RMS of its smoothed missing term, in `unit` and relative to its driven terms."""

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
    """Of each measured output; `ahead` are the errors of predictions, `structured` the tests that say what of it is noise."""
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
            told = floor_under_drift(errors)
            least = min(noise_floor(errors, lowest=UNDER_STRUCTURE), _unstructured(rmse, test), told.rms)
        else:
            least = noise_floor(errors)
            least = rmse if test is not None and rmse < BEYOND_NOISE * least else least
            told = Floor(least, at_most=False)
        found[output.name] = OutputError(
            unit=output.unit,
            rmse=rmse,
            fit_percent=100.0 * (1.0 - rmse / spread) if spread > 0 else float("nan"),
            bias=float(np.mean(error[known])),
            noise_floor=told.rms,
            noise_at_most=told.at_most,
            least_floor=least,
            k_step={steps: float(errors_ahead[k]) for steps, errors_ahead in ahead.items()},
        )
    return found


def _unstructured(rmse: float, test: StructuredError) -> float:
    """RMS of an error without its structured part, which the test knows from means over blocks: `noise_rms` is what they keep."""
    structured = test.noise_rms**2 * test.share / max(1.0 - test.share, 1e-300)
    return float(np.sqrt(max(rmse**2 - structured, test.noise_rms**2)))


def prediction_errors(kalman: Filter, experiments: list[Experiment], smoothed: list[Smoothed]) -> dict[int, FloatArray]:
    """RMS error of each output predicted 1, 10 and 100 samples ahead, missing terms held at their last estimate."""
    found = {}
    for steps in HORIZONS:
        long_enough = [(e, s) for e, s in zip(experiments, smoothed, strict=True) if e.n > 2 * steps]
        if not long_enough:
            continue
        errors = np.concatenate([_ahead(kalman, e, s, steps, PREDICTED_SAMPLES // len(long_enough)) for e, s in long_enough])
        count = np.isfinite(errors).sum(axis=0)
        found[steps] = np.sqrt(np.nansum(errors**2, axis=0) / np.where(count > 0, count, np.nan))
    return found


def _ahead(kalman: Filter, experiment: Experiment, smoothed: Smoothed, steps: int, most: int) -> FloatArray:
    """Prediction errors on a stretch from the record's middle, at most `most` samples and twice the horizon."""
    length = min(experiment.n, max(most, 2 * steps))
    start = (experiment.n - length) // 2
    part, filtered = experiment.window(start, start + length), smoothed.filtered[start : start + length]
    return part.Y - kalman.predict(part, replace(smoothed, filtered=filtered), steps)


def balance_errors(model: PhysicalModel, experiments: list[Experiment], smoothed: list[Smoothed]) -> dict[str, BalanceError]:
    """Of each balance whose missing term was estimated."""
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
