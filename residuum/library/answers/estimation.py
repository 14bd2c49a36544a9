"""The `estimate` object and its short report."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from residuum.identification.physics import Estimate
from residuum.identification.physics.estimation.unsettled import at_bounds
from residuum.library.answers.comparison import warning_lines
from residuum.library.answers.plain import value_text


def estimate_json(
    model: str, records: Sequence[str], result: Estimate, unsettled: Sequence[str] = ()
) -> dict[str, Any]:
    """The `estimate` object of the command line and the HTTP interface; values that are
    `unsettled`, or beside one at its bound, have no band.
    """
    declared = result.model.all_parameters
    reasons = [*unsettled, *at_bounds(result)]
    # Where a search stopped on its way the curvature there says nothing of the doubt: bands of 20 %
    # stood at numbers that were 170 times off.
    std = [None] * len(result.parameters) if reasons else result.std.tolist()
    values = zip(result.parameters, result.theta, std, strict=True)
    priors = {
        name: p.prior and {"value": p.prior.mean, "std": p.prior.std}
        for name, p in declared.items()
    }
    fit = _fit_percent(result)
    return {
        "model": model,
        "records": list(records),
        "parameters": {
            name: {
                "value": value,
                "std": std,
                "unit": declared[name].unit,
                "at_bound": name in result.at_bound,
                "prior": priors[name],
            }
            for name, value, std in values
        },
        **_of_records(result, settled=not reasons),
        "outputs": {
            name: {"unit": output.unit, "rmse": result.rmse[k], "fit_percent": fit[k]}
            for k, (name, output) in enumerate(result.model.outputs.items())
            if np.isfinite(result.rmse[k])
        },
        "flat_directions": [
            {"parameters": list(flat.parameters), "relative_weights": list(flat.weights)}
            for flat in result.flat
        ],
        "converged": not reasons,
        "unsettled": reasons,
        "iterations": result.iterations,
    }


def _of_records(result: Estimate, settled: bool) -> dict[str, Any]:
    """`per_record`, where the model has parameters with a value for each record."""
    of_records = {
        name: {
            "values": values.tolist(),
            "std": std.tolist() if settled else [None] * len(std),
            "unit": result.model.states[name].unit,
        }
        for name, (values, std) in result.of_records.items()
    }
    return {"per_record": of_records} if of_records else {}


def _fit_percent(result: Estimate) -> list[float]:
    residuals, predicted = np.concatenate(result.residuals), np.concatenate(result.predicted)
    fits = []
    for r, y_hat in zip(residuals.T, predicted.T, strict=True):
        finite = np.isfinite(r)
        # The measurement: an estimate holds residual and prediction.
        y = (r + y_hat)[finite]
        spread = float(np.linalg.norm(y - y.mean())) if finite.any() else 0.0
        fits.append(
            100.0 * (1.0 - float(np.linalg.norm(r[finite])) / spread)
            # A channel that stands still has no deviation from its mean to hold the error against.
            if spread > 0
            else float("nan")
        )
    return fits


def _parameter_text(name: str, p: dict[str, Any], settled: bool) -> str:
    unknown = "(not determined)" if settled else "(not settled)"
    doubt = unknown if p["std"] is None else f"± {p['std']:.2g}"
    known = f"  (prior {p['prior']['value']:g} ± {p['prior']['std']:g})" if p["prior"] else ""
    return (
        f"{name} = {p['value']:.6g} {doubt} {p['unit']}".rstrip()
        + ("  (at its bound)" if p["at_bound"] else "")
        + known
    )


def _slope_text(name: str, how: dict[str, Any]) -> str:
    """By what the slopes of an FMU's parameter were had."""
    if how["step"] is None:
        return f"slopes by {name}: {how['by']}"
    step = f"{how['step']:.2g} {how['unit']}".rstrip()
    return f"slopes by {name}: {how['by']}, {step} to each side, good to {how['error']:.1g} of them"


def _percent(fit: float | None) -> str:
    if fit is None or np.isnan(fit):
        return "unknown"
    # 0 % is what the measurement's mean alone would reach
    return f"{fit:.2f} %" if fit >= 0 else "below 0 %"


def estimate_text(estimate: dict[str, Any]) -> str:
    """The short human report of the `estimate` object."""
    settled = estimate["converged"]
    lines = [
        *warning_lines(estimate["warnings"]),
        *(_parameter_text(name, p, settled) for name, p in estimate["parameters"].items()),
    ]
    lines += [
        f"{name} of {record} = {value_text(value, math.nan if std is None else std, of['unit'])}"
        for name, of in estimate.get("per_record", {}).items()
        for record, value, std in zip(estimate["records"], of["values"], of["std"], strict=True)
    ]
    lines += [
        f"{name}: RMS error {o['rmse']:.4g} {o['unit']}, fit {_percent(o['fit_percent'])}"
        for name, o in estimate["outputs"].items()
    ]
    lines += [
        f"the data cannot tell apart: {', '.join(flat['parameters'])}"
        for flat in estimate["flat_directions"]
    ]
    lines += [_slope_text(name, how) for name, how in estimate.get("slopes", {}).items()]
    if not settled:
        lines.append(f"the estimation has not converged: {'; '.join(estimate['unsettled'])}")
    return "\n".join(
        [*lines, f"written to {estimate['model_file']}"] if estimate["model_file"] else lines
    )
