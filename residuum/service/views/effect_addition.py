"""Add one effect to a model and estimate it again: the work of the job behind "Add"."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import numpy as np

from residuum.identification.physics import (
    Estimate,
    Experiment,
    PhysicalModel,
    estimate,
    match,
    with_coloured_noise,
    write_model,
)
from residuum.identification.record import Record
from residuum.identification.residual_analysis.input_timing import at_likelier_timing
from residuum.service.views.model_view import model_of
from residuum.service.work.jobs import Progress
from residuum.service.work.record_parts import RecordParts

ESTIMATED_SHARE = 0.7
"""Part of each record that the parameters are estimated from; errors are told of the rest."""
_FEWEST_HELD_OUT = 50


def add_effect(
    progress: Progress,
    name: str,
    text: bytes | None,
    records: Sequence[RecordParts],
    mapping: Mapping[str, str],
    effect: str,
    target: str,
    values: Mapping[str, float],
) -> Mapping[str, Any]:
    """The model with one more effect, all free parameters estimated, and how its error fell.

    The parameters come from the first 70 % of each record, at the input timing that leaves the model with the effect the
    smaller error; their bands know the colour of the noise. `errors` are RMS simulation errors of every output on the rest
    (on the same data when the rest is too short: `held_out` says which): of the model as given, with its own parameters
    estimated, and with the effect. `values` are where the effect's parameters start.

    Raises
    ------
    BadModel
        An effect that does not fit there, or a value outside its bounds.
    BadRecord, BadUnit, NotIdentifiable
        Records that do not fit the model, or on which it diverges.
    """
    loaded = [Record(*parts) for parts in records]
    given = model_of(name, text)
    given.with_effect(effect, target, values)  # refused before anything is estimated
    matched, experiments = match(given, loaded, mapping)
    training, held_out = _parts(experiments)
    progress(0.1, "estimating the model as it is")
    before = estimate(matched, training)
    progress(0.4, f"estimating with {effect}")
    larger = before.model.with_effect(effect, target, values)
    timed, after = at_likelier_timing(training, lambda tried: with_coloured_noise(estimate(larger, tried), tried))
    if timed[0] is not training[0]:
        before = estimate(matched, timed)
    progress(0.8, "simulating what was held out")
    checked = [replace(e, hold=t.hold) for e, t in zip(held_out or training, timed, strict=True)]
    errors = {
        "as_given": _errors(matched, checked),
        "re_estimated": _errors(before.model, checked),
        "with_effect": _errors(after.model, checked),
    }
    label = after.model.effects[-1].label
    found = {
        "effect": effect,
        "target": target,
        "errors": errors,
        "units": {output.name: output.unit for output in matched.outputs.values()},
        "held_out": held_out is not None,
        "parameters": _parameters(after),
        "converged": after.converged,
    }
    provenance = {
        "added": datetime.now(UTC).isoformat(timespec="seconds"),
        "records": ", ".join(record.source for record in loaded)[:500],
        "held_out": held_out is not None,
        **errors,
    }
    return {**found, "file": write_model(after.model.with_provenance(label, provenance)).encode()}


def _parts(experiments: Sequence[Experiment]) -> tuple[list[Experiment], list[Experiment] | None]:
    cuts = [round(ESTIMATED_SHARE * e.n) for e in experiments]
    if any(e.n - cut < _FEWEST_HELD_OUT for e, cut in zip(experiments, cuts, strict=True)):
        return list(experiments), None
    pairs = list(zip(experiments, cuts, strict=True))
    return [e.window(0, cut) for e, cut in pairs], [e.window(cut, e.n) for e, cut in pairs]


def _errors(model: PhysicalModel, experiments: list[Experiment]) -> dict[str, float]:
    rmse = estimate(model, experiments, free=()).rmse
    return {name: float(rmse[k]) for k, name in enumerate(model.outputs) if np.isfinite(rmse[k])}


def _parameters(result: Estimate) -> dict[str, Any]:
    declared = result.model.all_parameters
    values = zip(result.parameters, result.theta, result.std, strict=True)
    return {
        name: {"value": float(value), "std": float(std), "unit": declared[name].unit, "at_bound": name in result.at_bound}
        for name, value, std in values
    }
