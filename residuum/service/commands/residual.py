"""`residuum residual design` and `residuum residual run`: a detector from an identified model, and what it says of a record."""

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer

from residuum.diagnosis.residuals.fault_estimation import PLANT_CHANGE, STUCK, FaultEstimate
from residuum.diagnosis.residuals.noise_model import NoiseModel
from residuum.diagnosis.residuals.residual_design import ResidualDesign, design_residual
from residuum.diagnosis.residuals.residual_detection import Detection, detect
from residuum.diagnosis.thresholds.threshold import EvaluationName, ThresholdKind
from residuum.identification.linear_models.identified_model_file import load_identified
from residuum.identification.linear_models.uncertainty import design_uncertainty_weight
from residuum.identification.record import Record
from residuum.service.commands.output_file import check_output_file
from residuum.service.commands.records import ChannelMap, MappingFile, Resample, SampleTime, Units, load_records
from residuum.service.commands.report import AsJson, progress, report
from residuum.service.commands.weight_options import (
    EPSILON,
    WEIGHT_ORDER,
    ZETA,
    Epsilon,
    Lowest,
    Points,
    Rule,
    WeightOrder,
    Zeta,
    frequencies,
)

app = typer.Typer(add_completion=False)
_STRUCTURED_P = 1e-3


@app.command()
def design(
    identified: Annotated[Path, typer.Argument(help="Model file, as `residuum identify` writes it.")],
    out: Annotated[Path, typer.Option(help="File for the design.")],
    fault: Annotated[Literal["sensor", "actuator"], typer.Option(help="Kind of fault to be most sensitive to.")] = "sensor",
    gamma: Annotated[float, typer.Option(help="Largest gain from model error and noise to the residual, γ.")] = 0.1,
    healthy: Annotated[
        list[Path] | None, typer.Option("--healthy", metavar="RECORD", help="Healthy records; default: those of the model.")
    ] = None,
    channel_map: ChannelMap = None,
    epsilon: Epsilon = EPSILON,
    zeta: Zeta = ZETA,
    rule: Rule = "chernoff",
    weight_order: WeightOrder = WEIGHT_ORDER,
    points: Points = None,
    lowest: Lowest = None,
    as_json: AsJson = False,
) -> None:
    """Design a robust residual generator from an identified model."""
    model = load_identified(identified)
    check_output_file(out)
    records = load_records(healthy, channel_map=channel_map) if healthy else _own_records(model.provenance.get("records", ()))
    grid = frequencies(model.sample_time, points, lowest)
    weight = design_uncertainty_weight(model, omega=grid, accuracy=epsilon, confidence=1 - zeta, rule=rule, order=weight_order)
    made = design_residual(model, weight.weight, records, fault=fault, gamma=gamma)
    made.save(out)
    report(_design_result(made, identified, out, records), _design_text(made, out), as_json=as_json)


def _own_records(names: Any) -> list[Record]:
    """The records a model was identified from, where they are still readable."""
    files = [Path(name) for name in names if isinstance(name, str) and name]
    if not files or not all(file.is_file() for file in files):
        progress("no healthy record at hand: noise as the model says, no `calibrated` threshold (give one with --healthy)")
        return []
    return load_records(files)


def _design_result(made: ResidualDesign, identified: Path, out: Path, records: list[Record]) -> dict[str, Any]:
    post_filter, noise = made.post_filter, made.noise
    return {
        "identified": str(identified),
        "file": str(out),
        "fault": made.fault,
        "gamma": made.gamma,
        "gamma_verified": post_filter.gamma,
        "gamma_on_grid": post_filter.gamma_grid,
        "beta": post_filter.beta,
        "decoupling": post_filter.decoupling,
        "filter_order": post_filter.Q.order,
        "full_order": post_filter.full_order,
        "reduction_error": post_filter.reduction_error,
        "stable": post_filter.Q.is_stable,
        "W_T": None if made.W_T is None else {"numerator": made.W_T.num, "denominator": made.W_T.den},
        "sample_time": made.model.sample_time,
        "warm_up_samples": made.generator.warm_up,
        "noise": {
            "sigma": noise.sigma,
            "unit": made.model.output_unit,
            "ar_order": len(noise.ar) - 1,
            "tail_dof": noise.dof,
            "shape": noise.shape,
            "tails": _tails(noise, made.model.output_unit),
            "degrees_of_freedom": noise.freedom,
        },
        "healthy_samples": sum(record.n for record in records),
        "structured_error": {"present": made.structured_p < _STRUCTURED_P, "p_value": made.structured_p},
    }


def _design_text(made: ResidualDesign, out: Path) -> str:
    f = made.post_filter
    lines = [
        f"residual for {made.fault} faults of {made.model.output_name!r}: γ = {f.gamma:.4g} (verified), β = {f.beta:.4g}, "
        f"β/γ = {f.decoupling:.3g}",
        f"post-filter of order {f.Q.order} (optimum: {f.full_order}, reduced with an error ≤ {f.reduction_error:.2g}) → {out}",
        f"healthy noise: {_size(made)}, {_colour(made.noise)}, tails {_tails(made.noise, made.model.output_unit)}",
    ]
    if made.structured_p < _STRUCTURED_P:
        lines.append(
            f"the healthy record carries structured error (p = {made.structured_p:.2g}): part of the plant is missing "
            "in the model; find it with `residuum explain` before trusting small residuals"
        )
    return "\n".join(lines)


def _size(made: ResidualDesign) -> str:
    return f"σ = {made.noise.innovation_std:.4g} {made.model.output_unit}".rstrip()


def _tails(noise: NoiseModel, unit: str) -> str:
    """The law of the noise in words, with the parameter that shapes it."""
    if noise.tail is not None:
        beyond = f"{noise.tail.start * noise.sigma:.4g} {unit}".rstrip()
        return f"beyond {beyond} those of its largest {100 * noise.tail.share:.2g} % of samples, which no usual law fits"
    if np.isfinite(noise.dof):
        return f"heavier than Gaussian (Student t, {noise.dof:.3g} degrees of freedom)"
    return "Gaussian" if noise.is_gaussian else f"lighter than Gaussian (exponential power, β = {noise.shape:.3g})"


def _colour(noise: NoiseModel) -> str:
    order = len(noise.ar) - 1
    return f"coloured (autoregression of order {order})" if order else "white"


@app.command()
def run(
    design: Annotated[Path, typer.Argument(help="Design file, as `residuum residual design` writes it.")],
    record: Annotated[Path, typer.Argument(metavar="RECORD", help="Record file.")],
    threshold: Annotated[ThresholdKind, typer.Option(help="Kind of threshold.")] = "posterior",
    false_alarms_per_day: Annotated[float, typer.Option(help="For the posterior and the calibrated threshold.")] = 1.0,
    evaluation: Annotated[EvaluationName | None, typer.Option(help="Default: glr; point for source and peak.")] = None,
    noise_bound: Annotated[float | None, typer.Option(help="Largest noise, for source and peak [output unit].")] = None,
    channel_map: ChannelMap = None,
    resample: Resample = False,
    mapping: MappingFile = None,
    sample_time: SampleTime = None,
    unit: Units = None,
    as_json: AsJson = False,
) -> None:
    """Run a residual design on a record: is there a fault, since when, which and how large?"""
    made = ResidualDesign.load(design)
    loaded = load_records(
        [record], mapping=mapping, resample=resample, sample_time=sample_time, units=unit, channel_map=channel_map
    )[0]
    found = detect(
        made,
        loaded,
        threshold=threshold,
        evaluation=evaluation,
        false_alarms_per_day=false_alarms_per_day,
        noise_bound=noise_bound,
    )
    report(_run_result(made, loaded, found), _run_text(made, loaded, found), as_json=as_json)


def _run_result(made: ResidualDesign, record: Record, found: Detection) -> dict[str, Any]:
    first = found.first_alarm
    return {
        "threshold": found.threshold.typical,
        "threshold_unit": found.threshold.unit,
        "threshold_kind": found.threshold.kind,
        "evaluation": found.threshold.evaluation,
        "guarantee": found.threshold.guarantee,
        "alarm": first is not None,
        "first_alarm_time": None if first is None else float(record.time[first]),
        "false_alarm_rate": found.threshold.false_alarms_per_day,
        "false_alarm_rate_unit": "1/day",
        "false_alarm_rate_factor_95": found.threshold.rate_factor,
        "fault_estimate": _estimate_result(record, found),
        "exceedances": int(found.alarm.sum()),
        "judged_samples": int(found.signals.valid.sum()),
        "gaps": found.gaps,
        "largest": float(np.max(found.statistic)),
        "structured_error": {"present": made.structured_p < _STRUCTURED_P, "p_value": made.structured_p},
    }


def _estimate_result(record: Record, found: Detection) -> dict[str, Any] | None:
    estimate = found.estimate
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


def _run_text(made: ResidualDesign, record: Record, found: Detection) -> str:
    limit = found.threshold
    first = found.first_alarm
    judged = f"{int(found.signals.valid.sum())} samples judged, {limit.evaluation} against the {limit.kind} threshold"
    lines = [f"{judged} {limit.typical:.4g} {limit.unit}".rstrip(), f"guarantee: {limit.guarantee}"]
    if found.gaps:
        lines.append(f"{found.gaps} gaps: the residual started anew after each")
    if first is None:
        return "\n".join([f"no alarm (largest {float(np.max(found.statistic)):.4g})", *lines])
    lines.insert(0, f"alarm at {float(record.time[first]):.6g} s, {int(found.alarm.sum())} exceedances")
    if (estimate := found.estimate) is not None:
        lines.insert(1, f"{_fault_text(estimate)}, {_since(made, record, estimate.onset)}{_alike(estimate)}")
    if made.structured_p < _STRUCTURED_P:
        lines.append("the healthy records already carried structured error: this may be missing physics, see `residuum explain`")
    return "\n".join(lines)


def _fault_text(estimate: FaultEstimate) -> str:
    if estimate.kind == STUCK:
        return f"{estimate.kind}: the reading stays at {estimate.value:.6g} {estimate.unit}".rstrip()
    if estimate.kind == PLANT_CHANGE:
        return f"{estimate.kind}: no single sensor or actuator fault explains it"
    low, high = estimate.band()
    return f"{estimate.kind} ({estimate.shape}): {estimate.value:.4g} (95 %: {low:.4g} … {high:.4g}) {estimate.unit}".rstrip()


def _since(made: ResidualDesign, record: Record, onset: int) -> str:
    """When the fault began, or that it was there before the first sample that could be judged."""
    judged_from = made.generator.warm_up
    if onset <= judged_from:
        return f"since before {record.t0 + judged_from * record.sample_time:.6g} s, the first that is judged"
    return f"since {record.t0 + onset * record.sample_time:.6g} s"


def _alike(estimate: FaultEstimate) -> str:
    kinds = estimate.indistinguishable_from
    return f"; cannot be told from {', '.join(kinds)}" if kinds else ""
