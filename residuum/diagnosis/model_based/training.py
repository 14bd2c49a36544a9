"""Training: healthy records and a model → a baseline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy import stats

from residuum.diagnosis.model_based.baseline import Baseline, Usual
from residuum.diagnosis.model_based.beside import Beside
from residuum.diagnosis.model_based.detection import Energies, calibrated, groups_of
from residuum.diagnosis.model_based.filtered_window import Filtered, TrackingFilter
from residuum.diagnosis.model_based.healthy_scatter import HealthyScatter, each_alone, healthy_scatter, joint_values, unit_of_each
from residuum.diagnosis.model_based.healthy_values import (
    HealthyValues,
    Undetermined,
    healthy_values,
    refuse_undetermined,
    value_columns,
)
from residuum.diagnosis.model_based.hypotheses import Hypothesis, Signals, hypotheses, slopes_of
from residuum.diagnosis.model_based.left_open import largest_sizes, left_open
from residuum.diagnosis.model_based.missing_physics import with_missing_physics
from residuum.diagnosis.model_based.reading_faults import longest_run
from residuum.diagnosis.model_based.usual_values import usual_values
from residuum.diagnosis.model_based.window_statistics import Colour, WindowStatistics, colours, statistics
from residuum.identification.blas_threads import one_thread
from residuum.identification.errors import BadInput, BadRecord
from residuum.identification.physics import Experiment, PhysicalModel, match
from residuum.identification.record import Record

Array = npt.NDArray[np.float64]

FEWEST_WINDOWS = 6
_WINDOWS = 20
"""Windows that few long records are cut into."""
_FEWEST_SAMPLES = 60
_CENTRED = 1
"""Times that values are moved to the middle of what the windows tell once the colour of the innovations is known."""
_BAND = 0.975
_TIMED_ON, _TIMED = 6, 10.0
"""Windows by which it is asked how inputs move between samples, and the rise of the log-likelihood that changes it."""


@one_thread()
def train(model: PhysicalModel, records: Sequence[Record], *, fix_undetermined: bool = False) -> Baseline:
    """Learn what is healthy.

    Each record is a window; fewer than 6 are cut into windows of equal length. Values are estimated from all of them, physics
    that they all show beyond the model is added for the time being, and what is usual in every size is taken from them.

    Raises
    ------
    Undetermined
        Windows leave a free value open (not with `fix_undetermined`, which keeps it at the file's value).
    BadRecord
        Records do not fit the model or each other, or are too short.
    """
    windows = windows_of(records)
    beside = Beside.of(model, windows)
    model, experiments = match(model, windows)
    experiments = _alike(experiments)
    free = tuple(model.free)
    values = healthy_values(model, experiments, free)
    timed = well_timed(values, experiments)
    if timed is not experiments:
        experiments = timed
        values = healthy_values(model, experiments, free)
    while True:
        try:
            refuse_undetermined(values)
            break
        except Undetermined as refused:
            if not fix_undetermined:
                raise
            free = tuple(name for name in free if name not in refused.parameters)
            values = healthy_values(_held(model, refused.parameters), experiments, free)
            model = _held(model, refused.parameters)
    values, stand_ins = with_missing_physics(values, experiments, free)
    listed = [h for h in hypotheses(values.tracking.model, values.tracking, values.windows) if _kept(h, values.free)]
    conditions = [beside.conditions(r) for r in windows]
    tracking, colour, sums = _summed(values.tracking, values.windows, listed, conditions)
    for _ in range(_CENTRED):
        tracking, filtered = _centred(tracking, experiments, listed, sums)
        tracking, colour, sums = _summed(tracking, filtered, listed, conditions)
    listed, sums = _visible(listed, sums, _sizes_of_reading(tracking.model, experiments))
    groups = groups_of([len(h.columns) for h in listed])
    at = {c.acts_on: g.sizes[0] for g, h in zip(groups, listed, strict=True) for c in h.columns[:1]}
    seen = tuple(name for name in values.free if f"parameter:{name}" in at)
    sizes = [at[f"parameter:{name}"] for name in seen]
    filtered, colour, sums = _at_usual_values(tracking, experiments, listed, healthy_scatter(sums, sizes), conditions)
    scatter, energies = healthy_scatter(sums, sizes), Energies.of(sums)
    calibration = calibrated(sums, scatter, sizes, groups)
    open_ = left_open(sums, scatter, listed, largest_sizes(tracking, filtered, listed))
    usual = _usual(experiments, sums, scatter, sizes)
    return Baseline(
        tracking,
        seen,
        {s.label: s.gain for s in stand_ins},
        listed,
        colour,
        scatter,
        calibration,
        energies,
        open_,
        usual,
        beside,
        experiments[0].sample_time,
        experiments[0].hold,
        np.all([e.measured for e in experiments], axis=0),
        [record.source for record in records],
    )


def _summed(
    tracking: TrackingFilter, filtered: Sequence[Filtered], listed: Sequence[Hypothesis], conditions: Sequence[Array]
) -> tuple[TrackingFilter, list[Colour], list[WindowStatistics]]:
    """The filter, the colour of its innovations, and the sums of each window."""
    signals = Signals(tracking.model, listed)
    J = [slopes_of(w, tracking, listed, signals.of(w, tracking.states(w))) for w in filtered]
    colour = colours(filtered, J, *value_columns(tracking.model, listed))
    return tracking, colour, [statistics(w, j, colour, x) for w, j, x in zip(filtered, J, conditions, strict=True)]


def _centred(
    tracking: TrackingFilter, experiments: Sequence[Experiment], listed: Sequence[Hypothesis], sums: Sequence[WindowStatistics]
) -> tuple[TrackingFilter, list[Filtered]]:
    """The filter with each value at the middle of what the windows by themselves tell, where it can follow them all."""
    at, scatter = value_columns(tracking.model, listed)
    columns = [c for h in listed for c in h.columns]
    middle = np.median(each_alone([w.scaled(unit_of_each(sums)) for w in sums], at), axis=0) * unit_of_each(sums)[at]
    values = {}
    for k, shift, most in zip(at, middle, scatter, strict=True):
        name = columns[k].acts_on.removeprefix("parameter:")
        there = tracking.model.values[name] + float(np.clip(shift, -most, most))
        values[name] = float(np.clip(there, columns[k].lower, columns[k].upper))
    moved = tracking.with_values(values)
    filtered = [moved.run(e) for e in experiments]
    if all(w.follows for w in filtered):
        return moved, filtered
    return tracking, [tracking.run(e) for e in experiments]


def _at_usual_values(
    tracking: TrackingFilter,
    experiments: Sequence[Experiment],
    listed: Sequence[Hypothesis],
    scatter: HealthyScatter,
    conditions: Sequence[Array],
) -> tuple[list[Filtered], list[Colour], list[WindowStatistics]]:
    """Each window along the track that its usual values give, the colour, and its sums, told about the model's values."""
    groups = groups_of([len(h.columns) for h in listed])
    usual = [usual_values(tracking.model, listed, groups, scatter, x) for x in conditions]
    filtered = [tracking.run(e, values) for e, (values, _) in zip(experiments, usual, strict=True)]
    if not all(w.follows for w in filtered):
        usual = [({}, np.zeros_like(moved)) for _, moved in usual]
        filtered = [tracking.run(e) for e in experiments]
    _, colour, sums = _summed(tracking, filtered, listed, conditions)
    return filtered, colour, [s.about(-moved) for s, (_, moved) in zip(sums, usual, strict=True)]


def windows_of(records: Sequence[Record]) -> list[Record]:
    """The records, or where they are few their parts of equal length."""
    if not records:
        raise BadRecord("model-based: no healthy record to train on")
    if len(records) >= FEWEST_WINDOWS:
        return list(records)
    length = max(min(r.n for r in records) * len(records) // _WINDOWS, _FEWEST_SAMPLES)
    parts = [r.window(k, k + length) for r in records for k in range(0, r.n - length + 1, length)]
    if len(parts) < FEWEST_WINDOWS:
        samples = sum(r.n for r in records)
        raise BadRecord(
            f"model-based: {len(records)} healthy records with {samples} samples; at least {FEWEST_WINDOWS} windows of "
            f"{_FEWEST_SAMPLES} samples are needed, 20 are good"
        )
    return parts


def _alike(experiments: Sequence[Experiment]) -> list[Experiment]:
    first = experiments[0]
    for e in experiments:
        if abs(e.sample_time / first.sample_time - 1.0) > 1e-3:
            raise BadRecord(
                f"record {e.source!r}: sampled every {e.sample_time:g} s, {first.source!r} every {first.sample_time:g} s; "
                "healthy windows must be alike"
            )
        if e.n < _FEWEST_SAMPLES:
            raise BadRecord(f"record {e.source!r}: {e.n} samples; a healthy window needs at least {_FEWEST_SAMPLES}")
    hold = np.array(np.mean([e.hold for e in experiments], axis=0) >= 0.5, dtype=float)
    return [replace(e, hold=hold) for e in experiments]


def well_timed(values: HealthyValues, experiments: list[Experiment]) -> list[Experiment]:
    """The windows with each input held over a sample or moving linearly between samples, as the outputs answer it."""
    some = slice(None, None, max(1, len(experiments) // _TIMED_ON))

    def likelihood(parts: Sequence[Experiment]) -> float:
        return sum(values.tracking.run(e, slopes=False).log_likelihood for e in parts)

    best, height = experiments, likelihood(experiments[some])
    for i, signal in enumerate(values.tracking.model.inputs.values()):
        if signal.absent:
            continue
        hold = best[0].hold.copy()
        hold[i] = 1.0 - hold[i]
        other = [replace(e, hold=hold) for e in best]
        there = likelihood(other[some])
        if there > height + _TIMED:
            best, height = other, there
    return best


def _held(model: PhysicalModel, names: Sequence[str]) -> PhysicalModel:
    held = {name: replace(p, fixed=p.fixed or name in names) for name, p in model.parameters.items()}
    return replace(model, parameters=held)


def _kept(h: Hypothesis, free: Sequence[str]) -> bool:
    """Whether a value is among those that windows are asked for; anything that is no value is."""
    acts_on = h.columns[0].acts_on
    return not acts_on.startswith("parameter:") or acts_on.removeprefix("parameter:") in free


def _sizes_of_reading(model: PhysicalModel, experiments: Sequence[Experiment]) -> dict[str, float]:
    """Largest magnitude of each input and output, by what acts on it."""
    Y, U = np.concatenate([e.Y for e in experiments]), np.concatenate([e.U for e in experiments])
    found = {f"output:{n}": float(np.nanmax(np.abs(Y[:, k]))) for k, n in enumerate(model.outputs) if np.isfinite(Y[:, k]).any()}
    return found | {f"input:{n}": float(np.max(np.abs(U[:, k]))) for k, n in enumerate(model.inputs)}


def _visible(
    listed: Sequence[Hypothesis], sums: Sequence[WindowStatistics], largest: dict[str, float]
) -> tuple[list[Hypothesis], list[WindowStatistics]]:
    """Hypotheses that a window can show at all: an offset smaller than the signal itself, a size with finite slopes."""
    std = 1.0 / np.sqrt(np.maximum(np.mean([np.diag(s.A) for s in sums], axis=0), 1e-300))
    kept, sizes = [], []
    for h, group in zip(listed, groups_of([len(h.columns) for h in listed]), strict=True):
        own = [std[k] for k in group.sizes]
        limit = [largest.get(c.acts_on, np.inf) if c.signal == "one" else np.inf for c in h.columns]
        if np.all(np.isfinite(own)) and all(s < least and s < 1e100 for s, least in zip(own, limit, strict=True)):
            kept.append(h)
            sizes += list(group.sizes)
    if not kept:
        raise BadInput("model-based: healthy windows show nothing of any parameter, sensor or actuator")
    return kept, [s.of(sizes) for s in sums]


def _usual(
    experiments: Sequence[Experiment], sums: Sequence[WindowStatistics], scatter: HealthyScatter, free: Sequence[int]
) -> Usual:
    judged = [scatter.judged(s) for s in sums]
    usual = np.array([scatter.mean(s.conditions) * scatter.scale for s in sums])
    d = np.array([np.maximum(np.diag(j.information), 1e-300) for j in judged])
    single = np.array([j.score for j in judged]) / d * scatter.scale
    together = np.array([joint_values(j, free)[0] for j in judged]).reshape(len(judged), len(free))
    spans = np.array([_span(e.Y) for e in experiments])
    runs = np.array([[longest_run(y).length for y in e.Y.T] for e in experiments])
    return Usual(
        experiments[0].sample_time * float(np.median([e.n for e in experiments])),
        np.min([np.diag(s.A) for s in sums], axis=0),
        spans.min(axis=0),
        spans.max(axis=0),
        np.min([np.ptp(e.U, axis=0) for e in experiments], axis=0),
        runs.max(axis=0),
        *_band(single + usual),
        *_band(together + usual[:, list(free)]),
    )


def _span(Y: Array) -> Array:
    there = np.isfinite(Y).any(axis=0)
    span = np.zeros(Y.shape[1])
    span[there] = np.nanmax(Y[:, there], axis=0) - np.nanmin(Y[:, there], axis=0)
    return span


def _band(values: Array) -> tuple[Array, Array]:
    """95 % band of one further value beside these, shape (windows, sizes)."""
    n = len(values)
    reach = stats.t.ppf(_BAND, n - 1) * np.sqrt(1.0 + 1.0 / n) * values.std(axis=0, ddof=1)
    return values.mean(axis=0) - reach, values.mean(axis=0) + reach
