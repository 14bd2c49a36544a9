"""Training: healthy records and a model → a baseline.

The model's values over all windows together, climbed along the ladder of horizons; the model mended by what every window lacks;
then each window's own estimate, whose mean and scatter carry all that is inexact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from residuum.array_types import FloatArray
from residuum.diagnosis.model_based.baseline import Baseline, Usual, alone
from residuum.diagnosis.model_based.kind_of_run import KindOfRun
from residuum.diagnosis.model_based.mending import evenly, held, mended
from residuum.diagnosis.model_based.policy import (
    APART,
    CALIBRATED,
    CUT_INTO,
    FEWEST_IN_A_WINDOW,
    FEWEST_WINDOWS,
    OPEN,
)
from residuum.diagnosis.model_based.scatter import Scatter
from residuum.diagnosis.model_based.trying import tried
from residuum.diagnosis.model_based.variant import Variant
from residuum.diagnosis.model_based.whitening import Whitening
from residuum.diagnosis.model_based.window_fit import Fit, information, log_power
from residuum.identification.blas_threads import one_thread
from residuum.identification.errors import BadRecord, NotIdentifiable
from residuum.identification.physics import EffectUse, Experiment, PhysicalModel, estimate, match
from residuum.identification.physics.estimation import gauss_newton
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.data import Data, data_of
from residuum.identification.unseen_blocks.ladder import climb, climb_at_likelier_timing


class Undetermined(NotIdentifiable):
    """Healthy windows do not determine some of the model's parameters, which are named."""

    def __init__(self, message: str, parameters: Sequence[str]) -> None:
        super().__init__(message)
        self.parameters = tuple(parameters)


@one_thread()
def train(
    model: PhysicalModel, records: Sequence[Record], *, fix_undetermined: bool = False, known: Sequence[EffectUse] = ()
) -> Baseline:
    """Learn what is healthy.

    Each record is a window; fewer than 6 are cut into windows of equal length. `known` are effects that healthy windows
    were found to show before beyond the model: they stay what the model lacks.

    Raises
    ------
    Undetermined
        Windows leave a free value open (not with `fix_undetermined`, which keeps it at the file's value).
    BadRecord
        Records do not fit the model or each other, or are too short.
    """
    asked, experiments = match(model, windows_of(records))
    experiments = _alike(experiments)
    here = asked
    for use in known:
        if use.key not in [own.key for own in asked.effects]:
            here = here.with_effect(*use.key, {name: p.value for name, p in use.parameters.items()})
    climbed = climb_at_likelier_timing(data_of(here, experiments))
    data, found = climbed.data, climbed.found
    while wide := [name for name in _open(found) if name in asked.parameters]:
        if not fix_undetermined:
            raise _refusal(asked, data, wide)
        data = data_of(held(data.model, wide[:1]), data.experiments)  # with the widest one held, others may be determined
        found = climb(data).found
    better, experiments = mended(found.model, data.experiments, _sized(found.model, data.experiments))
    return _calibrated(_learned(asked, better, experiments, [record.source for record in records]), experiments)


def windows_of(records: Sequence[Record]) -> list[Record]:
    """The records, or where they are few their parts of equal length."""
    if not records:
        raise BadRecord("model-based: no healthy record to train on")
    if len(records) >= FEWEST_WINDOWS:
        return list(records)
    length = max(min(r.n for r in records) * len(records) // CUT_INTO, FEWEST_IN_A_WINDOW)
    parts = [r.window(k, k + length) for r in records for k in range(0, r.n - length + 1, length)]
    if len(parts) < FEWEST_WINDOWS:
        samples = sum(r.n for r in records)
        raise BadRecord(
            f"model-based: {len(records)} healthy records with {samples} samples; at least {FEWEST_WINDOWS} windows of "
            f"{FEWEST_IN_A_WINDOW} samples are needed, 20 are good"
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
        if e.n < FEWEST_IN_A_WINDOW:
            raise BadRecord(f"record {e.source!r}: {e.n} samples; a healthy window needs at least {FEWEST_IN_A_WINDOW}")
        if np.any(e.measured != first.measured):
            raise BadRecord(f"records {e.source!r} and {first.source!r}: have different outputs; healthy windows must be alike")
    hold = np.array(np.mean([e.hold for e in experiments], axis=0) >= 0.5, dtype=float)
    return [replace(e, hold=hold) for e in experiments]


def _open(found: gauss_newton.Fit) -> list[str]:
    """Values that all healthy windows together leave open, the widest first."""
    now = found.model.values
    share = {name: std / max(abs(now[name]), 1e-300) for name, std in zip(found.parameters, found.std.tolist(), strict=True)}
    return sorted(
        (name for name, wide in share.items() if not wide < OPEN), key=lambda name: -np.nan_to_num(share[name], nan=np.inf)
    )


def _refusal(model: PhysicalModel, data: Data, wide: Sequence[str]) -> Undetermined:
    driving = ", ".join(model.inputs) or "the machine"
    lacking = [name for name, there in zip(model.outputs, data.measured, strict=True) if not there]
    more = f", or record {' or '.join(lacking)} too" if lacking else ""
    return Undetermined(
        f"model {model.name!r}: healthy windows do not determine {', '.join(wide)}: record windows in which {driving} "
        f"moves faster and over a wider range{more}, or keep {'them' if len(wide) > 1 else 'it'} at the file's value: "
        "--fix-undetermined",
        wide,
    )


@dataclass(frozen=True, eq=False)
class _Windows:
    """Each window's own fit, and its features."""

    fits: list[Fit]
    F: FloatArray

    @property
    def theta(self) -> FloatArray:
        return np.array([fit.others for fit in self.fits])


def _learned(asked: PhysicalModel, model: PhysicalModel, experiments: Sequence[Experiment], sources: Sequence[str]) -> Baseline:
    """The baseline before its hypotheses are tried."""
    start = np.array([model.values[name] for name in model.free])
    whitening = _sized(model, experiments)
    for _ in range(2):
        whitening = Whitening.of([fit.error for fit in _each_alone(model, experiments, start, whitening)])
    kind = KindOfRun.of(experiments)
    each = _Windows(_each_alone(model, experiments, start, whitening), np.array([kind.features(e) for e in experiments]))
    told = [information(fit, len(start)) for fit in each.fits]
    values = Scatter.of(each.F, each.theta, told, 1e-3 * np.abs(start) + 1e-12)
    power = np.array([log_power(fit) for fit in each.fits])
    errors = Scatter.of(each.F, power, None, np.full(power.shape[1], 0.01))
    model = model.with_values(dict(zip(model.free, values.B[0].tolist(), strict=True)))
    diagonals = np.array([np.diag(h) for h in told]).reshape(len(told), len(start))
    mended = tuple(use.label for use in model.effects if use.label not in [own.label for own in asked.effects])
    unasked = np.zeros((len(told), len(model.outputs)))  # offsets are, once the values' scatter is known
    input_spans, spans = (np.array([np.ptp(x(e), axis=0) for e in experiments]).min(axis=0) for x in (_inputs, _readings))
    return Baseline(
        asked,
        model,
        mended,
        kind,
        whitening,
        values,
        errors,
        Scatter.of(each.F, unasked, None, unasked[0] + 1.0),
        {},
        diagonals.min(axis=0),
        np.median(diagonals, axis=0),
        input_spans,
        spans,
        experiments[0].measured,
        experiments[0].hold,
        experiments[0].sample_time,
        experiments[0].sample_time * float(np.median([e.n for e in experiments])),
        len(experiments),
        _apart(each.F, np.column_stack([each.theta, power])),
        list(sources),
    )


def _sized(model: PhysicalModel, experiments: Sequence[Experiment]) -> Whitening:
    """Nothing is known of errors yet but their size."""
    return Whitening.plain(np.maximum(np.nan_to_num(estimate(model, experiments, free=()).rmse), 1e-9))


def _each_alone(model: PhysicalModel, experiments: Sequence[Experiment], start: FloatArray, whitening: Whitening) -> list[Fit]:
    found = []
    for e in experiments:
        fit = alone(model, e, start, whitening)
        if fit is None:
            raise BadRecord(
                f"record {e.source!r}: the model diverges along it; look at it with `residuum compare`, or leave it out"
            )
        found.append(fit)
    return found


def _inputs(e: Experiment) -> FloatArray:
    return e.U


def _readings(e: Experiment) -> FloatArray:
    """Readings, a missing one as their mean."""
    count = np.maximum(np.isfinite(e.Y).sum(axis=0), 1)
    return np.where(np.isfinite(e.Y), e.Y, np.nan_to_num(e.Y).sum(axis=0) / count)


def _apart(F: FloatArray, x: FloatArray) -> tuple[int, ...]:
    """Windows that differ from all others in a value or in their error, each held against the scatter of the others."""
    found, n = [], len(x)
    for k in range(n):
        others = np.arange(n) != k
        scatter = Scatter.of(F[others], x[others], None, 1e-3 * np.abs(x).mean(axis=0) + 1e-12)
        mean, covariance = scatter.at(F[k])
        t = np.abs(x[k] - mean) / np.sqrt(np.diag(covariance))
        if 2.0 * x.size * stats.t.sf(t.max(), scatter.freedom) < APART:
            found.append(k)
    return tuple(found)


def _calibrated(baseline: Baseline, experiments: Sequence[Experiment]) -> Baseline:
    """With what each hypothesis gains in healthy windows, and how its sizes scatter there; offsets in all of them."""
    F = np.array([baseline.kind.features(e) for e in experiments])
    fitters = [baseline.fitter(e, f) for e, f in zip(experiments, F, strict=True)]
    offsets, told = np.array([baseline.offsets_in(one, one.fit(Variant(baseline.model))) for one in fitters]).swapaxes(0, 1)
    baseline = replace(baseline, offsets=Scatter.of(F, offsets, [np.diag(h) for h in told], 1e-6 * baseline.spans + 1e-300))
    every = []
    for k in evenly(len(experiments), CALIBRATED):
        healthy, found = tried(fitters[k], baseline.hypotheses, baseline.usual_gain)
        every.append((fitters[k], fitters[k].nats(healthy), found))
    usual = {}
    for h in baseline.hypotheses:
        there = [(f, null, t.fit) for f, null, found in every if (t := found.get(h.label))]
        gains = [max(null - f.nats(fit) + f.price(fit) - fit.paid, 0.0) for f, null, fit in there]
        usual[h.label] = Usual(float(np.mean(gains)) if gains else 0.0, _sizes([fit for *_, fit in there]))
    return replace(baseline, usual=usual)


def _sizes(fits: Sequence[Fit]) -> FloatArray:
    """Shape (windows, sizes); a hypothesis whose number of sizes differs from window to window has none that scatter."""
    counts = {len(fit.own) for fit in fits}
    return np.array([fit.own for fit in fits]) if len(counts) == 1 else np.zeros((0, 1))
