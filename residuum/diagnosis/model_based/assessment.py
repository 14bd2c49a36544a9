"""One window against a baseline: whether it can be judged, whether it differs, why, and by how
much.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from scipy import stats

from residuum.array_types import FloatArray
from residuum.diagnosis.finding import Finding, Verdict
from residuum.diagnosis.model_based.baseline import Baseline, own_estimate, wide_prior
from residuum.diagnosis.model_based.causes import Cause, causes
from residuum.diagnosis.model_based.hypotheses import Hypothesis
from residuum.diagnosis.model_based.policy import (
    COMPLETE,
    FEWEST_IN_A_WINDOW,
    LEAST_EXCITED,
    SHORTEST,
    STILL,
)
from residuum.diagnosis.model_based.variant import Variant
from residuum.diagnosis.model_based.window_fit import Fit, information
from residuum.diagnosis.thresholds.false_alarm_rate import SECONDS_A_DAY
from residuum.identification.blas_threads import one_thread
from residuum.identification.errors import BadRecord
from residuum.identification.physics import Experiment, match
from residuum.identification.record import Record
from residuum.identification.residual_analysis.noise import stretches

# Whether a window is healthy, at one rate of false alarms: its values by Hotelling's T² and each by
# itself, its error power, and offsets of its readings.
#
# References: H. Hotelling, Ann. Math. Stat. 2 (1931) 360; C. R. Rao, Linear Statistical Inference,
# 2nd ed. 1973, 8c (one direction of T²).

_TESTS = 4  # error power, offsets, all values together, each value by itself


@dataclass(frozen=True, eq=False)
class Detected:
    """How a window differs from healthy ones.

    Attributes
    ----------
    p : float
        Probability that a healthy window of such a run differs as much.
    mean, covariance : array, shapes (values,), (values, values)
        Of values in healthy windows of such a run.
    error_excess : array, shape (2 · outputs,)
        How far error power lies above the usual [standard deviations].
    """

    p: float
    mean: FloatArray
    covariance: FloatArray
    error_excess: FloatArray


def detected(
    baseline: Baseline, fit: Fit, offsets: tuple[FloatArray, FloatArray], features: FloatArray
) -> Detected:
    """Hold the window's own estimate, its error and its offsets (with the information on them)
    against healthy ones; Bonferroni's bound over the tests.
    """
    mean, covariance = baseline.values.at(features)
    z, freedom = baseline.error_excess(features, fit), baseline.values.freedom
    # One-sided: an error smaller than usual is no fault. Student's t throughout, since every
    # scatter is known from so many windows only.
    p_values = [len(z) * float(stats.t.sf(z, baseline.errors.freedom).min(initial=1.0))]
    # An offset scatters by what healthy windows show and by what this window leaves open of it.
    usual, scatter = baseline.offsets.at(features)
    t = np.abs(offsets[0] - usual) / np.sqrt(
        np.diag(scatter) + 1.0 / np.maximum(offsets[1], 1e-300)
    )
    p_values.append(2.0 * len(t) * float(stats.t.sf(t, baseline.offsets.freedom).min(initial=1.0)))
    if k := len(mean):
        d, H = fit.values - mean, information(fit, k)
        # (S + H⁻¹)⁻¹, where H may be singular
        T = H - H @ np.linalg.solve(H + np.linalg.inv(covariance), H)
        # Hotelling's T² as an F statistic: t2 · m / (k · freedom) ~ F(k, m)
        t2 = max(float(d @ T @ d), 0.0)
        m = max(freedom - k + 1.0, 1.0)
        alone = (T @ d) ** 2 / np.maximum(np.diag(T), 1e-300)  # what one value alone explains of it
        p_values.append(float(stats.f.sf(t2 * m / (k * freedom), k, m)))
        p_values.append(
            k * float(stats.f.sf(alone * m / np.maximum(freedom + t2 - alone, 1e-12), 1, m).min())
        )
    return Detected(min(1.0, _TESTS * min(p_values)), mean, covariance, z)


_RAREST = 1e-300  # a p-value of 0 by rounding has no normal deviation


class NotAssessable(Exception):
    """A window cannot be judged; the message says why."""


@dataclass(frozen=True, eq=False)
class EstimatedWindow:
    """A window that can be judged.

    Attributes
    ----------
    window : Experiment
        The record in the baseline's terms.
    features : array, shape (1 + features,)
        Of its kind of run.
    fit : Fit
        Of the healthy model with all values free.
    offsets : tuple of array, shape (outputs,) each
        The offset that each reading seems to have, and the information on it.
    """

    window: Experiment
    features: FloatArray
    fit: Fit
    offsets: tuple[FloatArray, FloatArray]


@one_thread()
def assess(name: str, baseline: Baseline, record: Record, false_alarms_per_day: float) -> Finding:
    """The finding on one window; its indicator is the rarity of such a window among healthy ones,
    as a normal deviation.

    A window with holes is judged by its longest stretch without one, where that is longer than half
    a healthy window.
    """
    whole = record
    record = complete_stretch(
        whole, _required(baseline), COMPLETE * baseline.seconds / baseline.sample_time
    )
    try:
        observed = estimated_window(baseline, record)
    except NotAssessable as refused:
        return Finding.not_assessable(name, str(refused))
    detection = detected(baseline, observed.fit, observed.offsets, observed.features)
    # the chance that one healthy window may alarm with, of windows that follow without overlap
    level = min(0.5, false_alarms_per_day * baseline.seconds / SECONDS_A_DAY)
    deviation, limit = (float(stats.norm.isf(max(p, _RAREST))) for p in (detection.p, level))
    faulty = deviation > limit
    # causes are sought only where there is something to explain: they take most of the time
    listed = causes(baseline, observed.window, observed.features) if faulty else []
    cause_rows = [_cause_row(baseline, detection, record, cause) for cause in listed]
    evidence: dict[str, Any] = {
        "causes": cause_rows,
        "parameters": _parameters(baseline, observed, detection),
        "false_alarms_per_day": false_alarms_per_day,
        "healthy_windows": baseline.windows,
        "rate_without_extrapolation": rate_alone(baseline),
        "missing_physics": missing_physics(baseline),
        "held_values": [asdict(value) for value in baseline.doubted],
    }
    reason = _reason(baseline, max(deviation, 0.0), limit, cause_rows, false_alarms_per_day)
    if record is not whole:
        evidence["judged"] = {
            "from": record.t0,
            "to": record.t0 + record.duration,
            "samples": record.n,
            "of": whole.n,
        }
        reason += (
            f"; judged by the {record.n} of {whole.n} samples from {record.t0:.6g} s on, between"
            " which none is missing"
        )
    fault_class = _class(listed[0]) if listed else None
    verdict = Verdict.FAULTY if faulty else Verdict.HEALTHY
    indicators = {"deviation": max(deviation, 0.0)}
    return Finding(
        name,
        verdict,
        fault_class,
        indicators,
        {"deviation": max(limit, 0.0)},
        {"deviation": "σ"},
        evidence,
        reason,
    )


def estimated_window(baseline: Baseline, record: Record) -> EstimatedWindow:
    """A window with the estimates of it that are held against healthy ones.

    Raises
    ------
    NotAssessable
        It cannot be judged.
    BadRecord
        A channel is absent.
    """
    window = _experiment(baseline, record)
    if _stands_still(baseline, window):
        raise NotAssessable(
            "the machine stands still or hardly moves: nothing can be compared with the model"
        )
    features = baseline.kind.features(window)
    fitter = baseline.fitter(window, features)
    # The own estimate begins at the usual values and, once more, where the healthy fit ended: a
    # descent from one place ended at five times the error (benchmarks/results/model_based.md).
    usual = fitter.fit(Variant(baseline.model))
    fit = own_estimate(baseline.model, window, fitter.mean, baseline.whitening, usual)
    if fit is None:
        raise NotAssessable("the model diverges along the window")
    # a large error weighs less in the information, however much moves
    loud = max(1.0, float(fit.power.mean(axis=0).max()))
    info = loud * np.diag(information(fit, len(baseline.free)))
    if info.size and np.all(info < LEAST_EXCITED * np.maximum(baseline.information, 1e-300)):
        raise NotAssessable(
            "the window says next to nothing of any value of the model: let its inputs move as they"
            " did in the healthy windows"
        )
    return EstimatedWindow(window, features, fit, baseline.offsets_in(fitter, usual))


def _required(baseline: Baseline) -> list[str]:
    """The signals that a window must have."""
    inputs = [n for n, s in baseline.model.inputs.items() if not s.absent]
    return inputs + [
        n for n, known in zip(baseline.model.outputs, baseline.measured, strict=True) if known
    ]


def _experiment(baseline: Baseline, record: Record) -> Experiment:
    model, Ts, required = baseline.model, baseline.sample_time, _required(baseline)
    for name in required:
        if name not in record.names:
            raise BadRecord(
                f"record {record.source!r}: channel {name!r} is missing; the columns are"
                f" {', '.join(record.names)}"
            )
    if abs(record.sample_time / Ts - 1.0) > 1e-3:
        raise NotAssessable(
            f"sampled every {record.sample_time:g} s; the baseline was trained at {Ts:g} s"
        )
    shortest = max(FEWEST_IN_A_WINDOW, int(SHORTEST * baseline.seconds / Ts))
    if record.n < shortest:
        raise NotAssessable(f"{record.n} samples; at least {shortest} are needed")
    for name in required:
        missing = np.flatnonzero(record.missing(name))
        if missing.size:
            at = record.time[int(missing[0])]
            raise NotAssessable(
                f"channel {name!r} has {missing.size} missing samples, the first at {at:.6g} s"
            )
    _, (experiment,) = match(model, [record])
    return replace(
        experiment, hold=baseline.hold, Y=np.where(baseline.measured, experiment.Y, np.nan)
    )


def _stands_still(baseline: Baseline, window: Experiment) -> bool:
    """Whether neither an input nor an output moves."""
    driven = [i for i, signal in enumerate(baseline.model.inputs.values()) if not signal.absent]
    inputs = np.ptp(window.U[:, driven], axis=0) <= STILL * baseline.input_spans[driven]
    outputs = (
        np.ptp(window.Y[:, baseline.measured], axis=0) <= STILL * baseline.spans[baseline.measured]
    )
    return bool(np.all(inputs) and np.all(outputs))


def rate_alone(baseline: Baseline) -> float:
    """False alarms a day that healthy windows vouch for without extrapolation: n of them show no
    chance rarer than one in n + 1.
    """
    return SECONDS_A_DAY / baseline.seconds / (baseline.windows + 1.0)


def missing_physics(baseline: Baseline) -> list[dict[str, Any]]:
    """Effects that healthy windows show too, and the model file lacks: what was found is no fault
    of the machine.
    """
    values, known, missing = baseline.model.values, baseline.model.all_parameters, []
    for use in baseline.stand_ins:
        sizes = {
            n: {"value": values[f"{use.label}.{n}"], "unit": known[f"{use.label}.{n}"].unit}
            for n in use.parameters
        }
        missing.append({"effect": use.id, "place": use.target, "parameters": sizes})
    return missing


def _parameters(
    baseline: Baseline, observed: EstimatedWindow, detection: Detected
) -> dict[str, Any]:
    """Every value as this window tells it, all at once, with its 95 % band in healthy windows of
    such a run.
    """
    k = len(baseline.free)
    # the wide prior keeps finite what the window says nothing of
    H = information(observed.fit, k) + np.linalg.inv(wide_prior(detection.mean))
    std = np.sqrt(np.diag(np.linalg.pinv(H, hermitian=True)))
    reach = float(stats.t.ppf(0.975, baseline.values.freedom)) * np.sqrt(
        np.diag(detection.covariance) + std**2
    )
    return {
        name: {
            "value": float(observed.fit.values[j]),
            "std": float(std[j]),
            "unit": baseline.model.all_parameters[name].unit,
            "healthy": {
                "low": float(detection.mean[j] - reach[j]),
                "high": float(detection.mean[j] + reach[j]),
            },
        }
        for j, name in enumerate(baseline.free)
    }


@dataclass(frozen=True)
class CauseSize:
    """A cause's first size in the units that a reader is told, with its standard deviation."""

    value: float
    std: float
    healthy: tuple[float, float] | None


def _size_of(
    baseline: Baseline, detection: Detected, record: Record, cause: Cause
) -> CauseSize | None:
    """The first size of a cause; None where it has none or nothing is known of it."""
    h = cause.hypothesis
    if h is None or not len(cause.size) or not np.isfinite(cause.std[0]):
        return None
    times = record.sample_time if h.in_samples else 1.0
    return CauseSize(
        float(cause.size[0]) * times,
        float(cause.std[0]) * times,
        _usual_band(baseline, detection, h.label, times),
    )


def _cause_row(
    baseline: Baseline, detection: Detected, record: Record, cause: Cause
) -> dict[str, Any]:
    """A cause as the interface gives it."""
    h = cause.hypothesis
    size = _size_of(baseline, detection, record, cause)
    onset, since = None, ""
    if cause.onset:
        onset = record.t0 + cause.onset * record.sample_time
        since = f", since {onset - record.t0:.4g} s into the window"
    healthy = None if size is None else size.healthy
    row: dict[str, Any] = {"kind": "unknown", "name": "unknown", "place": ""}
    if h is not None:
        row = {"kind": h.kind, "name": h.name, "place": h.place}
    return row | {
        "probability": cause.probability,
        "indistinguishable_from": list(cause.alike),
        "beside": list(cause.beside),
        "value": None if h is None or size is None else _value_row(size, h.unit),
        "healthy": None if healthy is None else {"low": healthy[0], "high": healthy[1]},
        "onset_time": onset,
        "says": cause_sentence(h, size, since),
    }


def _value_row(size: CauseSize, unit: str) -> dict[str, Any]:
    return {
        "value": size.value,
        "std": size.std,
        "unit": unit,
        "band_95": [size.value - 1.96 * size.std, size.value + 1.96 * size.std],
    }


def _usual_band(
    baseline: Baseline, detection: Detected, label: str, times: float
) -> tuple[float, float] | None:
    """95 % of a value, or of a hypothesis' first size, in healthy windows; None where it was not
    tried there.
    """
    if label in baseline.free:
        j = baseline.free.index(label)
        reach = float(stats.t.ppf(0.975, baseline.values.freedom)) * float(
            np.sqrt(detection.covariance[j, j])
        )
        return float(detection.mean[j]) - reach, float(detection.mean[j]) + reach
    usual = baseline.usual.get(label)
    if usual is None or len(usual.sizes) < 3:
        return None
    # Student's prediction interval of one further window
    first = usual.sizes[:, 0] * times
    reach = (
        float(stats.t.ppf(0.975, len(first) - 1))
        * float(first.std(ddof=1))
        * float(np.sqrt(1.0 + 1.0 / len(first)))
    )
    return float(first.mean()) - reach, float(first.mean()) + reach


CLASSES: Sequence[str] = (
    "healthy",
    "parameter",
    "effect",
    "disturbance",
    "unknown",
    "sensor-offset",
    "sensor-gain",
    "sensor-noise",
    "sensor-stuck",
    "sensor-delay",
    "sensor-drop-out",
    "sensor-drift",
    "actuator-offset",
    "actuator-gain",
    "actuator-stuck",
    "actuator-delay",
)


def _class(cause: Cause) -> str:
    if cause.hypothesis is None:
        return "unknown"
    h = cause.hypothesis
    name = f"{h.kind}-{h.name}"
    if name in CLASSES:
        return name
    return h.kind if h.kind in CLASSES else "effect"


def _reason(
    baseline: Baseline,
    deviation: float,
    limit: float,
    cause_rows: list[dict[str, Any]],
    rate: float,
) -> str:
    beyond = "beyond" if deviation > limit else "within"
    words = (
        f"the window lies {deviation:.1f} σ from healthy ones, {beyond} the limit of {limit:.1f}"
    )
    if cause_rows:
        first = cause_rows[0]
        alike = (
            f" (or {', '.join(first['indistinguishable_from'])})"
            if first["indistinguishable_from"]
            else ""
        )
        also = f", and {cause_rows[1]['says']}" if first["beside"] else ""
        words = f"{first['says']}{alike}{also}; {words}"
    if missing := missing_physics(baseline):
        names = " and ".join(f"{m['effect']}@{m['place']}" for m in missing)
        words += "".join(
            f"; {v.name} is held at {v.held:.4g} {v.unit}, and {v.value:.4g} {v.unit} would explain"
            f" healthy windows as much as {names}: correct it and train again"
            for v in baseline.doubted[:1]
        ) or (
            f"; healthy windows show {names} too, which the model lacks: find it with `residuum"
            " explain`, add it with `residuum improve` and train again"
        )
    allowed = rate_alone(baseline)
    if rate < allowed:
        many = int(np.ceil(SECONDS_A_DAY / baseline.seconds / rate))
        words += (
            f"; {baseline.windows} healthy windows by themselves allow {allowed:.3g} false alarms a"
            f" day, {rate:g} a day is extrapolated ({many} windows would show it)"
        )
    return words


# The longest stretch of a window in which every signal of the model was read.


def complete_stretch(record: Record, signals: Iterable[str], fewest: float) -> Record:
    """The longest stretch without a missing sample of these signals; the record itself where that
    is not longer than `fewest`.

    A polled bus loses a sample now and then. A simulation cannot go on over a missing input, and
    none is invented; but what was read before it, or after it, is as good as any window.
    """
    lost = np.zeros(record.n, dtype=bool)
    for name in signals:
        if name in record.names:
            lost |= record.missing(name)
    longest = max(stretches(~lost), key=lambda run: run.stop - run.start, default=slice(0, 0))
    n = longest.stop - longest.start
    return record.window(longest.start, longest.stop) if fewest < n < record.n else record


# What is found, in sentences that a maintenance engineer understands.

_SENSOR = {
    "offset": "{place} reads {value} too much",
    "gain": "{place} reads {percent} of what it measures too much",
    "delay": "{place} comes {value} late",
    "noise": "{place} is noisier than when healthy by {value}",
    "stuck": "{place} stands at {value} although the machine moves",
    "drop-out": "{place} loses {percent} of its readings",
    "drift": "{place} drifts by {value}",
}
_ACTUATOR = {
    "offset": "{place} acts as if it were {value} more than commanded",
    "gain": "{place} acts {percent} more than commanded",
    "stuck": "{place} does not follow its command",
    "delay": "{place} acts {value} late",
}


def number(value: float, std: float | None = None) -> str:
    """A number with as many figures as its doubt leaves.

    >>> number(0.03124, 0.0021), number(1234.5, 20.0), number(0.5)
    ('0.0312 ± 0.0021', '1234 ± 20', '0.5')
    >>> number(3.04e-6, 1e-7), number(123456.0, 30000.0)
    ('3.04e-06 ± 1e-07', '123000 ± 3e+04')
    """
    if not std:
        return f"{value:.4g}"
    figures = max(2, min(6, 2 + _decades(value) - _decades(std)))
    shown = f"{value:.{figures}g}"
    # a number with more figures before its point than it may show: 1.2e+03 is told as 1200
    shown = f"{float(shown):.0f}" if "e+" in shown else f"{float(shown):g}"
    return f"{shown} ± {std:.2g}"


def _decades(value: float) -> int:
    return int(f"{abs(value):e}".partition("e")[2]) if value else 0


def cause_sentence(hypothesis: Hypothesis | None, size: CauseSize | None, since: str) -> str:
    """One sentence: what, how much, what is usual when healthy, since when."""
    if hypothesis is None:
        return "something that no single parameter, effect, sensor or actuator explains"
    h = hypothesis
    amount, percent = "", ""
    if size is not None:
        unit = "" if h.unit in ("", "1") else f" {h.unit}"
        amount = number(size.value, 1.96 * size.std) + unit
        percent = f"{100 * size.value:.3g} %"
    templates = {"sensor": _SENSOR, "actuator": _ACTUATOR}.get(h.kind, {})
    if h.name in templates:
        words = templates[h.name].format(place=h.place, value=amount, percent=percent)
        return f"{h.kind} {words}{since}"
    if h.kind == "disturbance":
        return f"a load that nobody recorded acts on the {h.place}{since}"
    where = f" of the {h.place}" if h.place else ""
    amount = f" {amount}" if amount else ", of a size that the window leaves open"
    usual = ""
    if size is not None and size.healthy is not None:
        low, high = size.healthy
        usual = f", healthy {number(low)} to {number(high)}"
    return f"{h.name.replace('-', ' ')}{where}{amount}{usual}{since}"
