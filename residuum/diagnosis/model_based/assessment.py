"""One window against a baseline: whether it can be judged, whether it differs, why, and by how much."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from residuum.diagnosis.finding import Finding, Verdict
from residuum.diagnosis.model_based.baseline import Baseline
from residuum.diagnosis.model_based.causes import Cause, causes, stuck_at
from residuum.diagnosis.model_based.detection import rate_alone
from residuum.diagnosis.model_based.filtered_window import Filtered
from residuum.diagnosis.model_based.healthy_scatter import joint_values
from residuum.diagnosis.model_based.hypotheses import slopes_of
from residuum.diagnosis.model_based.sizes import Window
from residuum.diagnosis.model_based.window_statistics import sums_of, whitened
from residuum.diagnosis.model_based.wording import said
from residuum.diagnosis.thresholds.false_alarm_rate import SECONDS_A_DAY
from residuum.identification.blas_threads import one_thread
from residuum.identification.errors import BadRecord
from residuum.identification.physics import Experiment, match
from residuum.identification.record import Record

Array = npt.NDArray[np.float64]

_SHORTEST = 0.25
"""Share of a healthy window's length under which a window is too short."""
_FEWEST = 50
_EXCITED = 0.03
"""Share of a healthy window's information on some parameter that a window needs."""
_FLAT = 0.05
"""Share of a healthy window's smallest span under which an output is taken to stand."""
_MOVED, _NEAR = 3, 1.0
"""Times that a window is followed anew with the values that it tells, and standard deviations within which it is not."""
_FOLLOWED = 0.3
"""Share of a window's readings that the filter must have followed."""


class NotAssessable(Exception):
    """A window cannot be judged; the message says why."""


@one_thread()
def assess(name: str, baseline: Baseline, record: Record, false_alarms_per_day: float) -> Finding:
    """The finding on one window."""
    try:
        window = followed(baseline, record)
    except NotAssessable as refused:
        return Finding.not_assessable(name, str(refused))
    limit = baseline.calibration.limit(false_alarms_per_day, baseline.usual.seconds)
    each = deviations(baseline, window)
    energies = baseline.energies.deviations(window.sums)
    standing = _standing(baseline, window)
    largest = max(float(np.max(each)), float(np.max(energies)), 0.0 if standing is None else 2.0 * limit)
    if stands_still(baseline, window) or (standing is None and not_excited(baseline, window)):
        return Finding.not_assessable(name, "the machine stands still or hardly moves: nothing can be compared with the model")
    faulty = largest > limit
    found = causes(baseline, window) if faulty else []
    told = [_told(baseline, window, record, cause) for cause in found]
    evidence: dict[str, Any] = {
        "causes": told,
        "parameters": parameters(baseline, window),
        "false_alarms_per_day": false_alarms_per_day,
        "healthy_windows": baseline.scatter.windows,
        "rate_without_extrapolation": rate_alone(baseline.scatter.windows, baseline.usual.seconds),
        "missing_physics": missing_physics(baseline),
    }
    indicators = {"deviation": largest}
    reason = _reason(baseline, largest, limit, told, evidence["missing_physics"], false_alarms_per_day)
    fault_class = None if not told else _class(found[0])
    verdict = Verdict.FAULTY if faulty else Verdict.HEALTHY
    return Finding(name, verdict, fault_class, indicators, {"deviation": limit}, {"deviation": "σ"}, evidence, reason)


def followed(baseline: Baseline, record: Record) -> Window:
    """The window in the baseline's terms; NotAssessable when it cannot be judged, BadRecord when a channel is absent."""
    experiment = _experiment(baseline, record)
    tracking, conditions = baseline.tracking, baseline.beside.conditions(record)
    values, moved = baseline.usual_values(conditions)
    filtered = tracking.run(experiment, values)
    if not filtered.follows:
        values, moved = dict(tracking.model.values), np.zeros_like(moved)
        filtered = tracking.run(experiment, values)
    if not filtered.follows:
        raise NotAssessable("the model's filter cannot follow the window: it diverges")
    if filtered.judged_share < _FOLLOWED:
        raise NotAssessable("the model's filter loses the machine at standstill for most of the window")
    return _judged(baseline, filtered, conditions, values, moved)


def _judged(baseline: Baseline, filtered: Filtered, conditions: Array, values: Mapping[str, float], moved: Array) -> Window:
    """The window along a track that was followed with these values, `moved` in size from the model's."""
    tracking, scatter = baseline.tracking, baseline.scatter
    signals = baseline.signals.of(filtered, tracking.states(filtered))
    slopes = slopes_of(filtered, tracking, baseline.hypotheses, signals)
    rows = whitened(filtered, filtered.normalised, baseline.colours)
    white = whitened(filtered, slopes, baseline.colours)
    sums, mean = sums_of(filtered, rows, white, conditions), scatter.mean(conditions) - moved / scatter.scale
    return Window(filtered, signals, rows, white, sums, scatter.judged(sums, mean), scatter.weights(sums), mean, values)


def _experiment(baseline: Baseline, record: Record) -> Experiment:
    model, Ts = baseline.tracking.model, baseline.sample_time
    required = [n for n, s in model.inputs.items() if not s.absent]
    required += [n for n, there in zip(model.outputs, baseline.measured, strict=True) if there]
    for name in required:
        if name not in record.names:
            raise BadRecord(f"record {record.source!r}: channel {name!r} is missing; the columns are {', '.join(record.names)}")
    if abs(record.sample_time / Ts - 1.0) > 1e-3:
        raise NotAssessable(f"sampled every {record.sample_time:g} s; the baseline was trained at {Ts:g} s")
    shortest = max(_FEWEST, int(_SHORTEST * baseline.usual.seconds / Ts))
    if record.n < shortest:
        raise NotAssessable(f"{record.n} samples; at least {shortest} are needed")
    for name in required:
        missing = np.flatnonzero(record.missing(name))
        if missing.size:
            at = record.time[int(missing[0])]
            raise NotAssessable(f"channel {name!r} has {missing.size} missing samples, the first at {at:.6g} s")
    _, (experiment,) = match(model, [record])
    return replace(experiment, hold=baseline.hold)


def _standing(baseline: Baseline, window: Window) -> int | None:
    """The first output whose sensor stands although the machine moves."""
    for o, there in enumerate(baseline.measured):
        if there and stuck_at(baseline, window, o) is not None:
            return o
    return None


def stands_still(baseline: Baseline, window: Window) -> bool:
    """Whether neither an input nor an output moves."""
    e, spans = window.filtered.experiment, baseline.usual.input_spans
    Y = e.Y[:, baseline.measured]
    driven = [i for i, signal in enumerate(baseline.tracking.model.inputs.values()) if not signal.absent]
    inputs = np.ptp(e.U[:, driven], axis=0) <= _FLAT * spans[driven]
    outputs = np.ptp(Y, axis=0) <= _FLAT * baseline.usual.spans[baseline.measured]
    return bool(np.all(inputs) and np.all(outputs))


def not_excited(baseline: Baseline, window: Window) -> bool:
    """Whether the window says next to nothing of any parameter that healthy windows tell."""
    at = baseline.free_sizes or baseline.scatter.own.tolist()
    told = np.diag(window.sums.A)[at] / np.maximum(baseline.usual.information[at], 1e-300)
    return bool(np.max(told) < _EXCITED)


def deviations(baseline: Baseline, window: Window) -> Array:
    """Each hypothesis' rarity as a normal deviation, shape (hypotheses,)."""
    return baseline.calibration.deviations(window.judged, np.diag(window.sums.A), baseline.groups)


def parameters(baseline: Baseline, window: Window) -> dict[str, Any]:
    """Every value as this window tells it, all at once, with its healthy band.

    A window that tells them far from where it was followed is followed anew with what it told: to first order alone a wear would
    be told the smaller, the further it has gone, and its limit too late.
    """
    for _ in range(_MOVED):
        further = _further(baseline, window)
        if further is None:
            break
        window = further
    shift, std = joint_values(window.judged, baseline.free_sizes)
    model, found = baseline.tracking.model, {}
    mean = (window.mean * baseline.scatter.scale)[baseline.free_sizes]
    for k, name in enumerate(baseline.free):
        at = model.values[name]
        found[name] = {
            "value": window.values[name] + mean[k] + shift[k],
            "std": std[k],
            "unit": model.all_parameters[name].unit,
            "healthy": {
                "low": at + baseline.usual.together_low[k],
                "high": at + baseline.usual.together_high[k],
            },
        }
    return found


def _further(baseline: Baseline, window: Window) -> Window | None:
    """The window followed with the values that it tells; None where these are near enough, or the filter cannot follow."""
    at, scatter, model = baseline.free_sizes, baseline.scatter, baseline.tracking.model
    shift, std = joint_values(window.judged, at)
    here = np.array([window.values[name] for name in baseline.free])
    told = here + (window.mean * scatter.scale)[at] + shift
    if np.all(np.abs(told - here) <= _NEAR * std):
        return None
    known = [model.all_parameters[name] for name in baseline.free]
    there = np.clip(told, [p.lower for p in known], [p.upper for p in known])
    values = {**window.values, **dict(zip(baseline.free, there.tolist(), strict=True))}
    filtered = baseline.tracking.run(window.filtered.experiment, values)
    moved = np.zeros(len(scatter.scale))
    moved[at] = there - [model.values[name] for name in baseline.free]
    return _judged(baseline, filtered, window.sums.conditions, values, moved) if filtered.follows else None


def missing_physics(baseline: Baseline) -> list[dict[str, Any]]:
    """Effects that healthy windows show too, and the model file lacks: what was found is no fault of the machine."""
    values, known = baseline.tracking.model.values, baseline.tracking.model.all_parameters
    found = []
    for use in baseline.tracking.model.effects:
        if use.label in baseline.stand_ins:
            sizes = {n: {"value": values[f"{use.label}.{n}"], "unit": known[f"{use.label}.{n}"].unit} for n in use.parameters}
            found.append({"effect": use.id, "place": use.target, "parameters": sizes})
    return found


def _told(baseline: Baseline, window: Window, record: Record, cause: Cause) -> dict[str, Any]:
    """A cause as the interface gives it: its size is the usual one, which need not be the model's, and the change beyond it."""
    value, low, high = cause.value, None, None
    if cause.size is not None and value is not None:
        low, high = float(baseline.usual.low[cause.size]), float(baseline.usual.high[cause.size])
        value += float(window.mean[cause.size] * baseline.scatter.scale[cause.size])
        acts_on = cause.columns[0].acts_on
        if acts_on.startswith("parameter:"):
            name = acts_on.removeprefix("parameter:")
            now = baseline.tracking.model.values[name]
            value, low, high = window.values[name] + value, now + low, now + high
    onset = record.t0 + cause.onset * record.sample_time
    since = f" since {onset:.6g} s" if cause.onset else ""
    size: dict[str, Any] | None = None
    if value is not None:
        std = cause.std or 0.0
        size = {"value": value, "std": std, "unit": cause.unit, "band_95": [value - 1.96 * std, value + 1.96 * std]}
    return {
        "kind": cause.kind,
        "name": cause.name,
        "place": cause.place,
        "probability": cause.probability,
        "indistinguishable_from": list(cause.alike),
        "value": size,
        "healthy": None if low is None else {"low": low, "high": high},
        "onset_time": onset if cause.onset else None,
        "says": said(cause, value, low, high, since),
    }


def _class(cause: Cause) -> str:
    if cause.kind == "sensor":
        return f"sensor-{cause.name}"
    if cause.kind == "actuator":
        return f"actuator-{cause.name}"
    return cause.kind


def _reason(
    baseline: Baseline, largest: float, limit: float, told: list[dict[str, Any]], missing: list[dict[str, Any]], rate: float
) -> str:
    beyond = "beyond" if largest > limit else "within"
    words = f"the window lies {largest:.1f} σ from healthy ones, {beyond} the limit of {limit:.1f}"
    if told:
        first = told[0]
        alike = f" (or {', '.join(first['indistinguishable_from'])})" if first["indistinguishable_from"] else ""
        words = f"{first['says']}{alike}; {words}"
    if missing:
        names = " and ".join(f"{m['effect']}@{m['place']}" for m in missing)
        words += (
            f"; healthy windows show {names} too, which the model lacks: find it with `residuum explain`, add it with "
            "`residuum improve` and train again"
        )
    alone = rate_alone(baseline.scatter.windows, baseline.usual.seconds)
    if rate < alone:
        many = int(np.ceil(SECONDS_A_DAY / baseline.usual.seconds / rate))
        words += (
            f"; {baseline.scatter.windows} healthy windows by themselves allow {alone:.3g} false alarms a day, {rate:g} a day is "
            f"extrapolated ({many} windows would show it)"
        )
    return words
