"""Estimation of a model's parameters from records, by one of three errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residuum.identification.errors import BadInput
from residuum.identification.physics import (
    Estimate,
    Experiment,
    PhysicalModel,
    estimate,
    estimate_by_likelihood,
    match,
    windows,
    with_coloured_noise,
)
from residuum.identification.record import Record
from residuum.identification.residual_analysis.input_timing import at_likelier_timing
from residuum.nearest_names import known_names

Method = Callable[[PhysicalModel, Sequence[Experiment], int], Estimate]

METHODS: dict[str, Method] = {
    "simulation": lambda model, experiments, _: _with_honest_band(model, experiments),
    "prediction": lambda model, experiments, steps: _with_honest_band(model, [w for e in experiments for w in windows(e, steps)]),
    "kalman": lambda model, experiments, _: estimate_by_likelihood(model, experiments),
}


@dataclass(frozen=True, eq=False)
class Estimated:
    """The estimate, its experiments, and each output's RMS error on what the split notes kept (None: nothing was kept)."""

    estimate: Estimate
    experiments: Sequence[Experiment]
    held_out_rmse: Mapping[str, float] | None


def estimated(
    model: PhysicalModel,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None = None,
    *,
    method: str = "simulation",
    steps: int = 50,
    hold: str = "auto",
) -> Estimated:
    """Estimate the free parameters; a note `split: 0.7` in a record keeps its rest for validation.

    Parameters
    ----------
    method : str
        The error that is minimised: `simulation`, `prediction` (`steps` samples ahead) or `kalman` (innovations).
    hold : str
        Inputs between samples: `auto`, `linear` or `zero-order`.

    Raises
    ------
    BadInput
        An unknown method; records that do not fit the model.
    NotIdentifiable
        The model diverges on a record.
    """
    if method not in METHODS:
        raise BadInput(f"method {method!r}: there is none of this name; {known_names(method, METHODS)}")
    start, experiments = match(model, records, mapping, hold)
    parts = [_estimation_part(e, record) for e, record in zip(experiments, records, strict=True)]
    if hold == "auto":
        parts, result = at_likelier_timing(parts, lambda tried: METHODS[method](start, tried, steps))
        experiments = [replace(e, hold=part.hold) for e, part in zip(experiments, parts, strict=True)]
    else:
        result = METHODS[method](start, parts, steps)
    return Estimated(result, parts, _held_out_error(result.model, experiments, records))


def _with_honest_band(model: PhysicalModel, experiments: Sequence[Experiment]) -> Estimate:
    return with_coloured_noise(estimate(model, experiments), experiments)


def _estimation_part(experiment: Experiment, record: Record) -> Experiment:
    return experiment if record.split is None else experiment.window(0, max(2, round(record.split * experiment.n)))


def _held_out_error(
    model: PhysicalModel, experiments: Sequence[Experiment], records: Sequence[Record]
) -> dict[str, float] | None:
    """RMS error of each output on the parts after the split, simulated with initial states of their own."""
    kept = [(e, r.split) for e, r in zip(experiments, records, strict=True) if r.split is not None]
    rests = [e.window(round(split * e.n), e.n) for e, split in kept if e.n - round(split * e.n) >= 2]
    if not rests:
        return None
    rmse = estimate(model, rests, free=()).rmse
    return {name: float(rmse[k]) for k, name in enumerate(model.outputs) if np.isfinite(rmse[k])}
