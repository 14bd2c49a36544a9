"""What a page draws of a model beside records: signals, residuals and missing terms; the work of
jobs.

The signals come back as records of their own, so that a page can zoom into them as into any record.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from math import inf
from typing import Any, NamedTuple

import numpy as np

from residuum.array_types import FloatArray
from residuum.diagnosis.residuals.movement_phases import phase_cells
from residuum.identification.errors import BadModel
from residuum.identification.physics import (
    Estimate,
    Experiment,
    Key,
    PhysicalModel,
    estimate,
    load_model,
    match,
    read_model,
    with_coloured_noise,
    write_model,
)
from residuum.identification.physics.effects.base import Parameter
from residuum.identification.physics.files.expression import Call, Name, Node, Number
from residuum.identification.record import Record
from residuum.identification.residual_analysis import term_curves
from residuum.identification.residual_analysis.compare import Comparison, compare
from residuum.identification.residual_analysis.feedback import a_step_away, at_likelier_timing
from residuum.identification.residual_analysis.locate import Axis
from residuum.library.answers.comparison import comparison_json
from residuum.library.questions.compare import Compare
from residuum.nearest_names import known_names
from residuum.service.views.signal_view import extremes
from residuum.service.work.jobs import Progress
from residuum.service.work.worker_pool import RecordParts

SHOWN_POINTS = 2500
"""Points of a cloud in all."""
# Bins of an axis that the mean of a term is drawn over.
_BINS = 40
# Lines of a residual's spectrum that are drawn.
_SPECTRUM_LINES = 600


class EffectUse(NamedTuple):
    """An effect at a balance, an input or an output, and values of its own parameters."""

    effect: str
    target: str
    values: Mapping[str, float]


def model_of(name: str, text: bytes | None) -> PhysicalModel:
    """The stored model of this text, or the built-in one of this name."""
    return load_model(name) if text is None else read_model(text.decode("utf-8"), name)


def view_model(
    progress: Progress,
    name: str,
    text: bytes | None,
    records: Sequence[RecordParts],
    mapping: Mapping[str, str],
    asked: Compare,
) -> Mapping[str, Any]:
    """The `compare` object, and what is drawn beside it.

    Returns
    -------
    mapping
        `comparison`; `signals`, a record's parts each (`y measured`, `y simulated`, `y residual` of
        every output); `points`, a thinned cloud of missing terms and residuals with the axes they
        may be shown along; `curves`, the mean and band of every term along every axis; `spectra` of
        the residuals; `phases`, every term by phase and direction.
    """
    loaded = [Record(*parts) for parts in records]
    progress(0.05, "simulating, and smoothing the missing terms")
    comparison = compare(model_of(name, text), loaded, mapping, level=asked.level, seed=asked.seed)
    progress(0.9, "preparing the charts")
    # Records one after the other: axes, terms and residuals have one row a sample of all of them.
    axes, terms = term_curves.joined(comparison.axes), _terms(comparison)
    return {
        "comparison": comparison_json(name, [record.source for record in loaded], comparison),
        "signals": [_signals(comparison, k) for k in range(len(loaded))],
        "points": _points(comparison, axes, terms),
        "curves": [_curve(axis, term) for term in terms for axis in axes],
        "spectra": list(_spectra(comparison)),
        "phases": list(_phases(comparison, terms)),
    }


def effect_curves(
    progress: Progress,
    name: str,
    text: bytes | None,
    records: Sequence[RecordParts],
    mapping: Mapping[str, str],
    effects: Sequence[EffectUse],
) -> Mapping[str, Any]:
    """What each effect would add to its balance, along every axis of the
    model's simulation.
    """
    loaded, curves = [Record(*parts) for parts in records], []
    model, experiments = match(model_of(name, text), loaded, mapping)
    for index, use in enumerate(effects):
        progress(index / len(effects), use.effect)
        key = Key(use.effect, use.target)
        along_axes = term_curves.effect_curves(model, experiments, key, use.values, loaded)
        for axis, curve in along_axes:
            curves.append(
                {
                    "effect": use.effect,
                    "balance": use.target,
                    "axis": axis.name,
                    "at": curve.at,
                    "value": curve.mean,
                }
            )
    return {"curves": curves}


def _terms(comparison: Comparison) -> list[dict[str, Any]]:
    """Missing terms of the balances, then residuals of the measured outputs, records one after the
    other.
    """
    terms: list[dict[str, Any]] = []
    for name in comparison.smoothed[0].missing:
        missing = [smoothed.missing[name] for smoothed in comparison.smoothed]
        value = np.concatenate([term.value for term in missing])
        std = np.concatenate([term.std for term in missing])
        terms.append(
            {"of": name, "kind": "balance", "unit": missing[0].unit, "value": value, "std": std}
        )
    for k, output in enumerate(comparison.model.outputs.values()):
        if output.name in comparison.outputs:
            value = np.concatenate([residual[:, k] for residual in comparison.simulation.residuals])
            terms.append(
                {
                    "of": output.name,
                    "kind": "output",
                    "unit": output.unit,
                    "value": value,
                    "std": None,
                }
            )
    return terms


def _phases(comparison: Comparison, terms: Sequence[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """Every term by phase and direction of the movement; none for a model without velocity,
    temperature or level.
    """
    ends = np.cumsum([experiment.n for experiment in comparison.experiments])[:-1]
    sample_times = [experiment.sample_time for experiment in comparison.experiments]
    for term in terms:
        cells = phase_cells(comparison.axes, sample_times, np.split(term["value"], ends))
        if cells is not None:
            yield {"of": term["of"], "unit": term["unit"], **cells}


def _signals(comparison: Comparison, number: int) -> RecordParts:
    experiment: Experiment = comparison.experiments[number]
    channels: dict[str, FloatArray] = {}
    units: dict[str, str] = {}
    for k, output in enumerate(comparison.model.outputs.values()):
        shown = {"simulated": comparison.simulation.predicted[number][:, k]}
        if experiment.measured[k]:
            shown |= {
                "measured": experiment.Y[:, k],
                "residual": comparison.simulation.residuals[number][:, k],
            }
        channels |= {
            f"{output.name} {kind}": np.ascontiguousarray(values) for kind, values in shown.items()
        }
        units |= {f"{output.name} {kind}": output.unit for kind in shown}
    return channels, units, experiment.sample_time, experiment.t0, (), experiment.source


def _points(
    comparison: Comparison, axes: Sequence[Axis], terms: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    sizes = [experiment.n for experiment in comparison.experiments]
    # Every k-th sample, of terms and axes alike, so that a point is one moment.
    shown = slice(None, None, max(1, -(-sum(sizes) // SHOWN_POINTS)))
    time = np.concatenate([e.sample_time * np.arange(e.n) for e in comparison.experiments])
    record = np.repeat(np.arange(len(sizes)), sizes)
    return {
        "record": record[shown].tolist(),
        "time": time[shown].tolist(),
        "axes": [
            {"name": a.name, "unit": a.unit, "kind": a.kind, "values": a.values[shown].tolist()}
            for a in axes
        ],
        "terms": [{**t, "value": t["value"][shown].tolist(), "std": None} for t in terms],
    }


def _curve(axis: Axis, term: Mapping[str, Any]) -> dict[str, Any]:
    """Mean of a term in bins of an axis, with ± two standard deviations of a missing term, or of a
    residual's scatter.
    """
    shown = term_curves.binned(axis.values, term["value"], _BINS)
    band = (
        shown.scatter
        if term["std"] is None
        else term_curves.binned(axis.values, term["std"], _BINS).mean
    )
    # Two deviations: 95 % where errors are normal.
    low, high = shown.mean - 2 * band, shown.mean + 2 * band
    return {
        "of": term["of"],
        "axis": axis.name,
        "at": shown.at,
        "mean": shown.mean,
        "low": low,
        "high": high,
    }


def _spectra(comparison: Comparison) -> Iterator[dict[str, Any]]:
    """Residual amplitude |E(f)|/√n over frequency of the first record (white noise of RMS σ is flat
    at σ).
    """
    experiment, residuals = comparison.experiments[0], comparison.simulation.residuals[0]
    for k, output in enumerate(comparison.model.outputs.values()):
        if output.name not in comparison.outputs:
            continue
        # A missing sample adds nothing to the spectrum of the others, as a zero does.
        error = np.where(np.isfinite(residuals[:, k]), residuals[:, k], 0.0)
        amplitude = extremes(
            np.abs(np.fft.rfft(error))[1:] / np.sqrt(experiment.n), _SPECTRUM_LINES
        )
        step = amplitude.samples / (experiment.n * experiment.sample_time)
        yield {"of": output.name, "unit": output.unit, "step": step, "amplitude": amplitude.maximum}


# Add one effect to a model and estimate it again: the work of the job behind "Add".

ESTIMATED_SHARE = 0.7
"""Part of each record that the parameters are estimated from; errors are told of the rest."""
# Samples of each record that its error is told of, or it is told of those that were estimated from.
_FEWEST_HELD_OUT = 50


def add_effect(
    progress: Progress,
    name: str,
    text: bytes | None,
    records: Sequence[RecordParts],
    mapping: Mapping[str, str],
    added: EffectUse,
) -> Mapping[str, Any]:
    """The model with one more effect, all free parameters estimated, and how its error fell.

    The parameters come from the first 70 % of each record, at the input timing that leaves the
    model with the effect the smaller error; their bands know the colour of the noise. `errors` are
    RMS simulation errors of every output on the rest (on the same data when the rest is too short:
    `held_out` says which): of the model as given, with its own parameters estimated, and with the
    effect. `added.values` are where the effect's parameters start.

    Raises
    ------
    BadModel
        An effect that does not fit there, or a value outside its bounds.
    BadRecord, BadUnit, NotIdentifiable
        Records that do not fit the model, or on which it diverges.
    """
    loaded = [Record(*parts) for parts in records]
    given = model_of(name, text)
    effect, target, values = added
    given.with_effect(effect, target, values)  # refused before anything is estimated
    matched, experiments = match(given, loaded, mapping)
    training, held_out = _parts(experiments)
    progress(0.1, "estimating the model as it is")
    before = estimate(matched, training)
    progress(0.4, f"estimating with {effect}")
    larger = before.model.with_effect(effect, target, values)
    # The timing by the error that it leaves, as `compare` chooses it: a controller's held force
    # looks as if it moved. Bands with the noise's colour: as of white noise they were six times too
    # narrow at a correlation of 0.95 from sample to sample.
    timed, after = at_likelier_timing(
        training,
        lambda tried: with_coloured_noise(estimate(larger, tried), tried),
        a_step_away,
    )
    # At another input timing the model as it is has another error, to be compared with the new one.
    if timed[0] is not training[0]:
        before = estimate(matched, timed)
    progress(0.8, "simulating what was held out")
    # Both models on the same data, at the timing that was found.
    checked = [replace(e, hold=t.hold) for e, t in zip(held_out or training, timed, strict=True)]
    errors = {
        "as_given": _errors(matched, checked),
        "re_estimated": _errors(before.model, checked),
        "with_effect": _errors(after.model, checked),
    }
    label = after.model.effects[-1].label
    answer = {
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
    return {**answer, "file": write_model(after.model.with_provenance(label, provenance)).encode()}


def _parts(experiments: Sequence[Experiment]) -> tuple[list[Experiment], list[Experiment] | None]:
    cuts = [round(ESTIMATED_SHARE * e.n) for e in experiments]
    # All records or none: errors of a part of them would not be those that were asked for.
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
        name: {
            "value": float(value),
            "std": float(std),
            "unit": declared[name].unit,
            "at_bound": name in result.at_bound,
        }
        for name, value, std in values
    }


# A physical model as a page shows it: signals, parameters, balances as expression trees, effects
# with their history.


def describe(model: PhysicalModel) -> dict[str, Any]:
    """The model as plain values; an expression is a tree of `["+", a, b]`, names (text) and
    numbers.
    """
    return {
        "name": model.name,
        "inputs": [
            {"name": signal.name, "unit": signal.unit, "required": signal.default is None}
            for signal in model.inputs.values()
        ],
        "outputs": [
            {"name": output.name, "unit": output.unit, "value": _tree(output.value.tree)}
            for output in model.outputs.values()
        ],
        "states": [
            {"name": state.name, "unit": state.unit, "rate": state.rate}
            for state in model.states.values()
        ],
        "parameters": [
            _parameter(name, parameter) for name, parameter in model.all_parameters.items()
        ],
        "balances": [
            {
                "name": balance.name,
                "kind": balance.kind,
                "unit": balance.unit,
                "storage": _tree(balance.storage.tree),
                "terms": [
                    {"name": name, "value": _tree(term.tree)}
                    for name, term in balance.terms.items()
                ],
            }
            for balance in model.balances.values()
        ],
        "effects": [
            {
                "effect": use.id,
                "title": use.effect.title,
                "equation": use.effect.equation,
                "target": use.target,
                "label": use.label,
                "parameters": [
                    _parameter(name, parameter) for name, parameter in use.parameters.items()
                ],
                "provenance": dict(use.provenance),
            }
            for use in model.effects
        ],
    }


def _parameter(name: str, parameter: Parameter) -> dict[str, Any]:
    return {
        "name": name,
        "value": parameter.value,
        "unit": parameter.unit,
        "lower": parameter.lower,
        "upper": parameter.upper,
        "fixed": parameter.fixed,
        "meaning": parameter.meaning,
    }


def _tree(node: Node) -> Any:
    if isinstance(node, Number):
        return node.value
    if isinstance(node, Name):
        return node.name
    if isinstance(node, Call) and node.function in ("table", "cubic"):
        # Positions first, then as many values.
        first, *knots = map(_tree, node.operands)
        return [
            "table",
            first,
            ["[]", *knots[: len(knots) // 2]],
            ["[]", *knots[len(knots) // 2 :]],
        ]
    return [node.function if isinstance(node, Call) else node.operator, *map(_tree, node.operands)]


# Change values, bounds and fixedness of a model's parameters, its structure as it is.

_UNBOUNDED = {"lower": -inf, "upper": inf}


def with_parameters(model: PhysicalModel, changes: Mapping[str, Mapping[str, Any]]) -> str:
    """The text of the model with some parameters changed.

    `changes` maps a parameter's full name (`R`, `coulomb-friction@shaft.tau_c`) to its new `value`,
    `lower`, `upper` (None: no bound) or `fixed`. BadModel for an unknown name, or for what no model
    file may hold (a value outside its bounds).
    """
    unknown = [name for name in changes if name not in model.all_parameters]
    if unknown:
        known = known_names(unknown[0], model.all_parameters, "there are")
        raise BadModel(f"model {model.name!r}: no parameter {unknown[0][:60]!r}; {known}")
    changed = {
        name: _changed(parameter, changes.get(name, {}))
        for name, parameter in model.all_parameters.items()
    }
    for name, parameter in changed.items():
        if name in changes and not parameter.lower <= parameter.value <= parameter.upper:
            bounds = f"{parameter.lower:g} … {parameter.upper:g} {parameter.unit}".rstrip()
            raise BadModel(f"parameter {name!r}: value {parameter.value:g} must be within {bounds}")
    effects = tuple(
        replace(use, parameters={name: changed[f"{use.label}.{name}"] for name in use.parameters})
        for use in model.effects
    )
    text = write_model(
        replace(
            model, parameters={name: changed[name] for name in model.parameters}, effects=effects
        )
    )
    # What is stored can be read: whatever the file's rules refuse is refused here.
    read_model(text, model.name)
    return text


def _changed(parameter: Parameter, change: Mapping[str, Any]) -> Parameter:
    fields: dict[str, Any] = {
        field: _UNBOUNDED.get(field) if value is None else value for field, value in change.items()
    }
    return replace(parameter, **fields)
