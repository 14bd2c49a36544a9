"""What a page draws of a model beside records: signals, residuals and missing terms; the work of jobs.

The signals come back as records of their own, so that a page can zoom into them as into any record.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from residuum.diagnosis.residuals.movement_phases import phase_cells
from residuum.identification.physics import Experiment, Key, PhysicalModel, load_model, match, read_model
from residuum.identification.record import Record
from residuum.identification.residual_analysis.compare import Comparison, compare
from residuum.identification.residual_analysis.places import term_curves
from residuum.identification.residual_analysis.places.locate import Axis
from residuum.library.answers.comparison import comparison_json
from residuum.library.questions.compare import Compare
from residuum.service.views.signal_view import extremes
from residuum.service.work.jobs import Progress
from residuum.service.work.record_parts import RecordParts

FloatArray = npt.NDArray[np.float64]

SHOWN_POINTS = 2500
"""Points of a cloud in all."""
_BINS = 40
_SPECTRUM_LINES = 600


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
        `comparison`; `signals`, a record's parts each (`y measured`, `y simulated`, `y residual` of every output);
        `points`, a thinned cloud of missing terms and residuals with the axes they may be shown along; `curves`, the mean
        and band of every term along every axis; `spectra` of the residuals; `phases`, every term by phase and direction.
    """
    loaded = [Record(*parts) for parts in records]
    progress(0.05, "simulating, and smoothing the missing terms")
    comparison = compare(model_of(name, text), loaded, mapping, level=asked.level, seed=asked.seed)
    progress(0.9, "preparing the charts")
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
    effects: Sequence[tuple[str, str, Mapping[str, float]]],
) -> Mapping[str, Any]:
    """What each effect (id, balance, values) would add to its balance, along every axis of the model's simulation."""
    loaded, found = [Record(*parts) for parts in records], []
    model, experiments = match(model_of(name, text), loaded, mapping)
    for index, (id, balance, values) in enumerate(effects):
        progress(index / len(effects), id)
        for axis, curve in term_curves.effect_curves(model, experiments, Key(id, balance), values, loaded):
            found.append({"effect": id, "balance": balance, "axis": axis.name, "at": curve.at, "value": curve.mean})
    return {"curves": found}


def _terms(comparison: Comparison) -> list[dict[str, Any]]:
    """Missing terms of the balances, then residuals of the measured outputs, records one after the other."""
    terms: list[dict[str, Any]] = []
    for name in comparison.smoothed[0].missing:
        missing = [smoothed.missing[name] for smoothed in comparison.smoothed]
        value, std = (np.concatenate([getattr(term, part) for term in missing]) for part in ("value", "std"))
        terms.append({"of": name, "kind": "balance", "unit": missing[0].unit, "value": value, "std": std})
    for k, output in enumerate(comparison.model.outputs.values()):
        if output.name in comparison.outputs:
            value = np.concatenate([residual[:, k] for residual in comparison.simulation.residuals])
            terms.append({"of": output.name, "kind": "output", "unit": output.unit, "value": value, "std": None})
    return terms


def _phases(comparison: Comparison, terms: Sequence[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """Every term by phase and direction of the movement; none for a model without velocity, temperature or level."""
    ends = np.cumsum([experiment.n for experiment in comparison.experiments])[:-1]
    sample_times = [experiment.sample_time for experiment in comparison.experiments]
    for term in terms:
        found = phase_cells(comparison.axes, sample_times, np.split(term["value"], ends))
        if found is not None:
            yield {"of": term["of"], "unit": term["unit"], **found}


def _signals(comparison: Comparison, number: int) -> RecordParts:
    experiment: Experiment = comparison.experiments[number]
    channels: dict[str, FloatArray] = {}
    units: dict[str, str] = {}
    for k, output in enumerate(comparison.model.outputs.values()):
        shown = {"simulated": comparison.simulation.predicted[number][:, k]}
        if experiment.measured[k]:
            shown |= {"measured": experiment.Y[:, k], "residual": comparison.simulation.residuals[number][:, k]}
        channels |= {f"{output.name} {what}": np.ascontiguousarray(values) for what, values in shown.items()}
        units |= {f"{output.name} {what}": output.unit for what in shown}
    return channels, units, experiment.sample_time, experiment.t0, (), experiment.source


def _points(comparison: Comparison, axes: Sequence[Axis], terms: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    sizes = [experiment.n for experiment in comparison.experiments]
    kept = slice(None, None, max(1, -(-sum(sizes) // SHOWN_POINTS)))
    time = np.concatenate([e.sample_time * np.arange(e.n) for e in comparison.experiments])
    record = np.repeat(np.arange(len(sizes)), sizes)
    return {
        "record": record[kept].tolist(),
        "time": time[kept].tolist(),
        "axes": [{"name": a.name, "unit": a.unit, "kind": a.kind, "values": a.values[kept].tolist()} for a in axes],
        "terms": [{**t, "value": t["value"][kept].tolist(), "std": None} for t in terms],
    }


def _curve(axis: Axis, term: Mapping[str, Any]) -> dict[str, Any]:
    """Mean of a term in bins of an axis, with ± two standard deviations of a missing term, or of a residual's scatter."""
    shown = term_curves.binned(axis.values, term["value"], _BINS)
    band = shown.scatter if term["std"] is None else term_curves.binned(axis.values, term["std"], _BINS).mean
    low, high = shown.mean - 2 * band, shown.mean + 2 * band
    return {"of": term["of"], "axis": axis.name, "at": shown.at, "mean": shown.mean, "low": low, "high": high}


def _spectra(comparison: Comparison) -> Iterator[dict[str, Any]]:
    """Residual amplitude |E(f)|/√n over frequency of the first record (white noise of RMS σ is flat at σ)."""
    experiment, residuals = comparison.experiments[0], comparison.simulation.residuals[0]
    for k, output in enumerate(comparison.model.outputs.values()):
        if output.name not in comparison.outputs:
            continue
        error = np.where(np.isfinite(residuals[:, k]), residuals[:, k], 0.0)
        amplitude = extremes(np.abs(np.fft.rfft(error))[1:] / np.sqrt(experiment.n), _SPECTRUM_LINES)
        step = amplitude.samples / (experiment.n * experiment.sample_time)
        yield {"of": output.name, "unit": output.unit, "step": step, "amplitude": amplitude.maximum}
