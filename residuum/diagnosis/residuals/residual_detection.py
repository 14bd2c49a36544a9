"""Fault detection on a record with a designed residual: Algorithm 6, with any threshold and
evaluation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from residuum.array_types import FloatArray
from residuum.diagnosis.residuals.fault_isolation import FaultEstimate, FaultEstimator
from residuum.diagnosis.residuals.generators.residual_generator import BoolArray, ResidualSignals
from residuum.diagnosis.residuals.residual_design import ROBUST, ResidualDesign
from residuum.diagnosis.residuals.residual_evaluation import CUSUM_REFERENCE, evaluate
from residuum.diagnosis.thresholds.false_alarm_rate import alarms_per_sample, cusum
from residuum.diagnosis.thresholds.threshold import (
    DEFAULT_EVALUATION,
    EvaluationName,
    Threshold,
    ThresholdKind,
    bounds,
    calibrated,
    peak_threshold,
    posterior_threshold,
    source_threshold,
)
from residuum.identification.errors import BadInput
from residuum.identification.record import Record

_AROUND = 4096  # samples before and after the alarm on which the fault is estimated


@dataclass(frozen=True, eq=False)
class Detection:
    """What a designed residual says of a record.

    Parameters
    ----------
    threshold : Threshold
    signals : ResidualSignals
    statistic : array, shape (n,)
        Evaluated residual, in the threshold's unit.
    alarm : array, shape (n,)
        Samples above the threshold; `cusum` and `glr` start anew after each.
    gaps : int
        Times missing samples re-initialised the residual.
    estimate : FaultEstimate or None
        Of the fault at the first alarm; its onset counts samples of the record.
    """

    threshold: Threshold
    signals: ResidualSignals
    statistic: FloatArray
    alarm: BoolArray
    gaps: int
    estimate: FaultEstimate | None

    @property
    def first_alarm(self) -> int | None:
        """Sample of the first alarm."""
        return int(np.argmax(self.alarm)) if self.alarm.any() else None


def detect(
    design: ResidualDesign,
    record: Record,
    *,
    threshold: ThresholdKind = "posterior",
    evaluation: EvaluationName | None = None,
    false_alarms_per_day: float = 1.0,
    noise_bound: float | None = None,
) -> Detection:
    """Run a design on a record.

    Parameters
    ----------
    evaluation : "point", "rms", "cusum", "glr" or None
        None: `glr` for `posterior` and `calibrated`, `point` for a classical method, whose filter
        the others do not use; `source` and `peak` hold for `point` alone.
    noise_bound : float or None
        ē of the `source` and `peak` thresholds; None: the largest healthy residual, or 4 σ without
        healthy records.

    Raises
    ------
    BadRecord, BadUnit
        Wrong rate, channel or unit; input and output swapped; too short to fill the model's memory.
    BadInput
        The threshold does not exist for this evaluation, or not without healthy records.
    """
    if threshold in ("source", "peak") and evaluation not in (None, "point"):
        raise BadInput(
            f"threshold {threshold!r}: bounds |r(t)| alone, so its evaluation is point, not"
            f" {evaluation}"
        )
    u, y = design.signals_of(record)
    design.refuse_swapped(record)
    stream = design.generator.stream()
    signals = stream.process(u, y)
    if not signals.valid.any():
        memory = design.generator.warm_up
        raise BadInput(
            f"record {record.source!r}: no stretch without a gap is longer than the model's memory,"
            f" {memory} samples"
        )
    # a classical post-filter shows only where it is looked at itself: the other evaluations scan
    # the whitened residual, which it does not make
    own = DEFAULT_EVALUATION[threshold] if design.method == ROBUST else "point"
    chosen = evaluation or own
    limit = _threshold(
        design,
        u,
        threshold,
        chosen,
        alarms_per_sample(false_alarms_per_day, design.model.sample_time),
        noise_bound,
    )
    statistic, alarm = _alarms(design, signals, limit)
    estimate = _estimate(design, u, y, int(np.argmax(alarm))) if alarm.any() else None
    return Detection(limit, signals, statistic, alarm, stream.gaps, estimate)


def _threshold(
    design: ResidualDesign,
    u: FloatArray,
    kind: ThresholdKind,
    evaluation: EvaluationName,
    rate: float,
    noise_bound: float | None,
) -> Threshold:
    if kind == "posterior":
        # a missing input has no error to follow: the operating point stands for it
        return posterior_threshold(
            design, np.where(np.isnan(u), design.input_mean, u), rate, evaluation
        )
    if kind == "calibrated":
        return calibrated(design, rate, evaluation)
    return (source_threshold if kind == "source" else peak_threshold)(
        design, *bounds(design, u, noise_bound)
    )


def _alarms(
    design: ResidualDesign, signals: ResidualSignals, threshold: Threshold
) -> tuple[FloatArray, BoolArray]:
    if threshold.evaluation == "glr":
        output = design.bank(threshold.typical).process(signals)
        return output.statistic, output.alarm
    if threshold.evaluation == "cusum":
        sums = cusum(signals.scores, signals.valid, CUSUM_REFERENCE, threshold.typical)
        return sums.statistic, np.asarray(sums.alarm != 0)
    statistic = evaluate(threshold.evaluation, design.bank, signals)
    return statistic, np.asarray((statistic > threshold.level) & signals.valid)


def _estimate(
    design: ResidualDesign, u: FloatArray, y: FloatArray, alarm: int
) -> FaultEstimate | None:
    """The fault around the alarm, on the stretch without gap that holds it."""
    # the estimator simulates, which it cannot across a gap
    broken = np.flatnonzero(np.isnan(u) | np.isnan(y))
    before, after = broken[broken < alarm], broken[broken > alarm]
    start = max(int(before[-1]) + 1 if len(before) else 0, alarm - _AROUND)
    stop = min(int(after[0]) if len(after) else len(u), alarm + _AROUND)
    model = design.model
    estimator = FaultEstimator(
        design.generator, model.covariance, model.delay, (model.input_unit, model.output_unit)
    )
    fault = estimator.estimate(u[start:stop], y[start:stop], alarm - start)
    return None if fault is None else fault.moved(start)
