"""The `residual design` and `residual run` objects and their short reports."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from residuum.diagnosis.residuals.fault_isolation import PLANT_CHANGE, STUCK, FaultEstimate
from residuum.diagnosis.residuals.noise_model import NoiseModel
from residuum.diagnosis.residuals.residual_design import ResidualDesign
from residuum.diagnosis.residuals.residual_detection import Detection
from residuum.identification.record import Record
from residuum.library.answers.plain import chance


def design_json(
    design: ResidualDesign, records: Sequence[Record], *, identified: str | None, file: str | None
) -> dict[str, Any]:
    """The `residual design` object; `identified` and `file` are the files of the model and of the
    design.
    """
    post_filter, noise = design.post_filter, design.noise
    return {
        "identified": identified,
        "file": file,
        "fault": design.fault,
        "method": design.method,
        "gamma": design.gamma,
        "gamma_verified": post_filter.gamma,
        "gamma_on_grid": post_filter.gamma_grid,
        "beta": post_filter.beta,
        "decoupling": post_filter.decoupling,
        "filter_order": post_filter.Q.order,
        "full_order": post_filter.full_order,
        "reduction_error": post_filter.reduction_error,
        "stable": post_filter.Q.is_stable,
        "W_T": (
            None
            if design.W_T is None
            else {"numerator": design.W_T.num, "denominator": design.W_T.den}
        ),
        "sample_time": design.model.sample_time,
        "warm_up_samples": design.generator.warm_up,
        "noise": {
            "sigma": noise.sigma,
            "unit": design.model.output_unit,
            "ar_order": len(noise.ar) - 1,
            "tail_dof": noise.dof,
            "shape": noise.shape,
            "tails": _tails(noise, design.model.output_unit),
            "degrees_of_freedom": noise.freedom,
        },
        "healthy_samples": sum(record.n for record in records),
        "structured_error": {
            "present": design.has_structured_error,
            "p_value": design.structured_p,
        },
    }


def design_text(design: ResidualDesign, file: str | None = None) -> str:
    """The short human report of a design that was perhaps written to `file`."""
    f = design.post_filter
    lines = [
        (
            f"{design.method} residual for {design.fault} faults of {design.model.output_name!r}: γ"
            f" = {f.gamma:.4g} (verified), β = {f.beta:.4g}, β/γ = {f.decoupling:.3g}"
        ),
        f"post-filter of order {f.Q.order} (optimum: {f.full_order}, reduced with an error ≤"
        f" {f.reduction_error:.2g})" + (f" → {file}" if file else ""),
        (
            f"healthy noise: {_size(design)}, {_colour(design.noise)}, tails"
            f" {_tails(design.noise, design.model.output_unit)}"
        ),
    ]
    if design.has_structured_error:
        lines.append(
            f"the healthy record carries structured error ({chance(design.structured_p)}): part of"
            " the plant is missing in the model; find it with `residuum explain` before trusting"
            " small residuals"
        )
    return "\n".join(lines)


def _size(design: ResidualDesign) -> str:
    return f"σ = {design.noise.innovation_std:.4g} {design.model.output_unit}".rstrip()


def _tails(noise: NoiseModel, unit: str) -> str:
    """The law of the noise in words, with the parameter that shapes it."""
    if noise.tail is not None:
        beyond = f"{noise.tail.start * noise.sigma:.4g} {unit}".rstrip()
        return (
            f"beyond {beyond} those of its largest {100 * noise.tail.share:.2g} % of samples, which"
            " no usual law fits"
        )
    if np.isfinite(noise.dof):
        return f"heavier than Gaussian (Student t, {noise.dof:.3g} degrees of freedom)"
    return (
        "Gaussian"
        if noise.is_gaussian
        else f"lighter than Gaussian (exponential power, β = {noise.shape:.3g})"
    )


def _colour(noise: NoiseModel) -> str:
    order = len(noise.ar) - 1
    return f"coloured (autoregression of order {order})" if order else "white"


def run_json(design: ResidualDesign, record: Record, detection: Detection) -> dict[str, Any]:
    """The `residual run` object of a record."""
    first = detection.first_alarm
    return {
        "threshold": detection.threshold.typical,
        "threshold_unit": detection.threshold.unit,
        "threshold_kind": detection.threshold.kind,
        "evaluation": detection.threshold.evaluation,
        "guarantee": detection.threshold.guarantee,
        "alarm": first is not None,
        "first_alarm_time": None if first is None else float(record.time[first]),
        "false_alarm_rate": detection.threshold.false_alarms_per_day,
        "false_alarm_rate_unit": "1/day",
        "false_alarm_rate_factor_95": detection.threshold.rate_factor,
        "fault_estimate": _estimate_json(record, detection),
        "exceedances": int(detection.alarm.sum()),
        "judged_samples": int(detection.signals.valid.sum()),
        "gaps": detection.gaps,
        "largest": float(np.max(detection.statistic)),
        "structured_error": {
            "present": design.has_structured_error,
            "p_value": design.structured_p,
        },
    }


def _estimate_json(record: Record, detection: Detection) -> dict[str, Any] | None:
    estimate = detection.estimate
    if estimate is None:
        return None
    return {
        "kind": estimate.kind,
        "shape": estimate.shape,
        "value": estimate.value,
        "std": estimate.std,
        "unit": estimate.unit,
        "band_95": list(estimate.band()),
        "onset_time": record.t0 + estimate.onset * record.sample_time,
        "indistinguishable_from": list(estimate.indistinguishable_from),
    }


def run_text(design: ResidualDesign, record: Record, detection: Detection) -> str:
    """The short human report of a run."""
    limit = detection.threshold
    first = detection.first_alarm
    judged = (
        f"{int(detection.signals.valid.sum())} samples judged, {limit.evaluation} against the"
        f" {limit.kind} threshold"
    )
    lines = [f"{judged} {limit.typical:.4g} {limit.unit}".rstrip(), f"guarantee: {limit.guarantee}"]
    if detection.gaps:
        lines.append(f"{detection.gaps} gaps: the residual started anew after each")
    if first is None:
        return "\n".join([f"no alarm (largest {float(np.max(detection.statistic)):.4g})", *lines])
    lines.insert(
        0, f"alarm at {float(record.time[first]):.6g} s, {int(detection.alarm.sum())} exceedances"
    )
    estimate = detection.estimate
    if estimate is not None:
        lines.insert(
            1,
            f"{_fault_text(estimate)}, {_since(design, record, estimate.onset)}{_alike(estimate)}",
        )
    if design.has_structured_error:
        lines.append(
            "the healthy records already carried structured error: this may be missing physics, see"
            " `residuum explain`"
        )
    return "\n".join(lines)


def _fault_text(estimate: FaultEstimate) -> str:
    if estimate.kind == STUCK:
        return (
            f"{estimate.kind}: the reading stays at {estimate.value:.6g} {estimate.unit}".rstrip()
        )
    if estimate.kind == PLANT_CHANGE:
        return f"{estimate.kind}: no single sensor or actuator fault explains it"
    low, high = estimate.band()
    return (
        f"{estimate.kind} ({estimate.shape}): {estimate.value:.4g} (95 %: {low:.4g} … {high:.4g})"
        f" {estimate.unit}".rstrip()
    )


def _since(design: ResidualDesign, record: Record, onset: int) -> str:
    """When the fault began, or that it was there before the first sample that could be judged."""
    judged_from = design.generator.warm_up
    # Before the filters' memory is full nothing is judged: an onset there may lie anywhere before.
    if onset <= judged_from:
        return (
            f"since before {record.t0 + judged_from * record.sample_time:.6g} s, the first that is"
            " judged"
        )
    return f"since {record.t0 + onset * record.sample_time:.6g} s"


def _alike(estimate: FaultEstimate) -> str:
    kinds = estimate.indistinguishable_from
    return f"; cannot be told from {', '.join(kinds)}" if kinds else ""
