"""The `residual design` and `residual run` objects of a plant with several inputs and outputs, and
their short reports.
"""

from __future__ import annotations

from typing import Any

from residuum.diagnosis.residuals.multivariable import MultivariableResidual
from residuum.diagnosis.residuals.multivariable_detection import (
    Hypothesis,
    IsolatedFault,
    MultivariableDetection,
)
from residuum.identification.record import Record


def design_json(design: MultivariableResidual, *, identified: str, file: str) -> dict[str, Any]:
    """The `residual design` object."""
    first, rows, noise = design.model.models[0], design.model.models, design.whitener
    return {
        "identified": identified,
        "file": file,
        "method": design.method,
        "inputs": [{"name": path.input_name, "unit": path.input_unit} for path in first],
        "unknown_inputs": list(design.unknown),
        "outputs": [{"name": row[0].output_name, "unit": row[0].output_unit} for row in rows],
        "residuals": design.Q.D.shape[0],
        "filter_order": design.Q.order,
        "sample_time": design.sample_time,
        "warm_up_samples": design.warm_up,
        "noise": {"innovation_std": noise.innovation_std, "order": len(noise.past)},
        "healthy_samples": noise.n,
    }


def design_text(result: dict[str, Any]) -> str:
    """The short human report of a design."""
    inputs = ", ".join(channel["name"] for channel in result["inputs"])
    outputs = ", ".join(channel["name"] for channel in result["outputs"])
    blind = f", blind to {', '.join(result['unknown_inputs'])}" if result["unknown_inputs"] else ""
    spread = ", ".join(f"{value:.4g}" for value in result["noise"]["innovation_std"])
    order = result["noise"]["order"]
    return "\n".join(
        [
            (
                f"{result['method']} residual of {inputs} → {outputs}{blind}: {result['residuals']}"
                f" residuals → {result['file']}"
            ),
            (
                f"healthy noise: σ = {spread},"
                f" {f'coloured (vector autoregression of order {order})' if order else 'white'},"
                f" from {result['healthy_samples']} samples; {result['warm_up_samples']} samples of"
                " warm-up"
            ),
        ]
    )


def run_json(
    record: Record, detection: MultivariableDetection, false_alarms_per_day: float
) -> dict[str, Any]:
    """The `residual run` object of a record."""
    first = detection.first_alarm
    return {
        "threshold": detection.threshold,
        # The statistic is a likelihood ratio, which has none.
        "threshold_unit": "",
        "threshold_kind": "posterior",
        "evaluation": "glr",
        "guarantee": (
            "at most so many false alarms a day while noise and model error are what the healthy"
            " records showed"
        ),
        "alarm": first is not None,
        "first_alarm_time": None if first is None else float(record.time[first]),
        "false_alarm_rate": false_alarms_per_day,
        "false_alarm_rate_unit": "1/day",
        "fault_estimate": None if detection.fault is None else _fault_json(record, detection.fault),
        "exceedances": int(detection.alarm.sum()),
        "judged_samples": int(detection.residual.valid.sum()),
        "largest": float(detection.statistic.max()),
    }


def _fault_json(record: Record, fault: IsolatedFault) -> dict[str, Any]:
    return {
        "kind": f"{fault.hypothesis.kind}-offset",
        "place": fault.hypothesis.name,
        "value": fault.value,
        "std": fault.std,
        "unit": fault.hypothesis.unit,
        # 1.96 standard deviations hold 95 % of a normal law.
        "band_95": [fault.value - 1.96 * fault.std, fault.value + 1.96 * fault.std],
        "onset_time": record.t0 + fault.onset * record.sample_time,
        "probability": fault.probability,
        "indistinguishable_from": [_named(rival) for rival in fault.indistinguishable_from],
    }


def run_text(result: dict[str, Any]) -> str:
    """The short human report of a run."""
    judged = (
        f"{result['judged_samples']} samples judged, glr against the posterior threshold"
        f" {result['threshold']:.4g}"
    )
    if not result["alarm"]:
        return "\n".join([f"no alarm (largest {result['largest']:.4g})", judged])
    lines = [f"alarm at {result['first_alarm_time']:.6g} s, {result['exceedances']} exceedances"]
    fault = result["fault_estimate"]
    if fault is not None:
        low, high = fault["band_95"]
        alike = (
            f"; cannot be told from {', '.join(fault['indistinguishable_from'])}"
            if fault["indistinguishable_from"]
            else ""
        )
        size = f"{fault['value']:.4g} (95 %: {low:.4g} … {high:.4g}) {fault['unit']}".rstrip()
        lines.append(
            f"{fault['kind']} of {fault['place']}: {size}, since {fault['onset_time']:.6g} s{alike}"
        )
    return "\n".join([*lines, judged])


def _named(hypothesis: Hypothesis) -> str:
    return f"{hypothesis.kind}-offset@{hypothesis.name}"
