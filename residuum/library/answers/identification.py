"""The `identify` object and its short report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from residuum.identification.errors import BadInput
from residuum.identification.kernel_based.marginal_bands import band_says
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.validation import simulation_fit
from residuum.identification.record import Record


def identification_json(
    model: IdentifiedModel, method: str, estimation: Sequence[Record], held_out: Sequence[Record]
) -> dict[str, Any]:
    """The contract's `identify` object, and what else a program may want."""
    return {
        "method": method,
        "order": model.order,
        "sample_time": model.sample_time,
        "impulse_response": model.impulse_response,
        "std": model.std,
        "std_says": _bands(model),
        "hyper_parameters": dict(model.hyper_parameters),
        "noise_variance": model.noise_variance,
        "negative_log_likelihood": model.negative_log_likelihood,
        "seconds": model.provenance.get("seconds"),
        "numerator": model.numerator,
        "denominator": model.denominator,
        "covariance": model.parameter_covariance,
        "aic": model.aic,
        "bic": model.bic,
        "model": model.method,
        "input": {"name": model.input_name, "unit": model.input_unit},
        "output": {"name": model.output_name, "unit": model.output_unit},
        "delay": model.delay,
        "offset": model.offset,
        "samples": model.provenance.get("n"),
        "fit_percent": [_fit(model, record) for record in estimation],
        "held_out_fit_percent": [_fit(model, record) for record in held_out],
        "warnings": list(model.warnings),
        "file": None,
    }


def _fit(model: IdentifiedModel, record: Record) -> float | None:
    try:
        return simulation_fit(model, record)
    except BadInput:
        return None  # a part too short to have a fit is no reason to withhold the model


def identification_text(model: IdentifiedModel, result: dict[str, Any]) -> str:
    """The short human report."""
    if not model.input_name:
        return _series_text(model, result)
    assumed = result.get("assumptions") or {}
    lines = [
        (
            f"{model.method}: {_named(model.input_name, model.input_unit)} →"
            f" {_named(model.output_name, model.output_unit)}, {result['samples']} samples of"
            f" {model.sample_time:g} s"
        ),
        (
            f"  impulse response  {model.order} coefficients from lag {model.delay};"
            f" {_largest(model, assumed)}"
        ),
        f"  static gain       {_gain_says(result['static_gain'])}",
        (
            f"  noise             {math.sqrt(model.noise_variance):.4g}{_spaced(model.output_unit)}"
            " (standard deviation)"
        ),
        f"  fit               {_fits(result['fit_percent'])} of the estimation data{_shown(model)}",
    ]
    lines += _fit_on_new_data(result["held_out_fit_percent"], assumed.get("kept_aside"))
    if result["std_says"] is not None:
        lines.append(f"  bands             {result['std_says']}")
    if model.hyper_parameters:
        values = [f"{name} {value:.4g}" for name, value in model.hyper_parameters.items()]
        lines.append(f"  hyper-parameters  {', '.join(values)}")
    lines += [f"  warning           {text}" for text in model.warnings]
    if result["file"]:
        lines.append(f"  written to        {result['file']}")
    return "\n".join(lines)


def _fit_on_new_data(
    held_out: Sequence[float | None], kept_aside: Sequence[Mapping[str, Any]] | None
) -> list[str]:
    """The fit on what split notes kept; where there are none, that of a fit of the first part on
    the last.
    """
    if held_out:
        return [f"  held-out fit      {_fits(held_out)}"]
    if kept_aside:
        aside_fits = _fits([part["fit_percent"] for part in kept_aside])
        return [f"  fit kept aside    {aside_fits} of the last 30 %, by the first 70 %"]
    return []


def _largest(model: IdentifiedModel, assumed: Mapping[str, Any]) -> str:
    if model.diverges:
        return "grows without bound, for the model is not stable"
    if (assumed.get("excitation") or {}).get("tells_model") is False:
        return "the record does not tell them"
    peak = int(np.argmax(np.abs(model.impulse_response)))
    size = f"largest {model.impulse_response[peak]:.4g} ± {model.std[peak]:.2g}{_gain_unit(model)}"
    return f"{size} at {(model.delay + peak) * model.sample_time:g} s"


def _shown(model: IdentifiedModel) -> str:
    return ", by one-step predictions" if model.diverges else ""


def static_gain(model: IdentifiedModel, assumed: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """G(1) with its standard deviation, or why it is unknown; None of a model without an input."""
    if not model.input_name:
        return None
    unit, unknown = _gain_unit(model).strip(), None
    if model.integrates:
        # The impulse response of an integrating model settles at a constant, its slope; as a sum of
        # differences that is its last value.
        slope = float(np.diff(model.impulse_response, prepend=0.0).sum())
        unknown = f"none: the model integrates {slope:.4g}{_gain_unit(model)} a sample"
    elif ((assumed or {}).get("excitation") or {}).get("tells_gain") is False:
        unknown = "the record does not tell it"
    if unknown is not None:
        return {"value": None, "std": None, "unit": unit, "unknown": unknown, "formal": False}
    # A variance of next to nothing may be rounded below 0.
    std = math.sqrt(max(float(model.frequency_covariance(0.0)[0, 0, 0]), 0.0))
    gain = float(model.frequency_response(0.0).real)
    return {"value": gain, "std": std, "unit": unit, "unknown": None, "formal": model.diverges}


def _gain_says(gain: Mapping[str, Any]) -> str:
    formal = "; formal, for the model is not stable" if gain["formal"] else ""
    known = (
        f"{gain['value']:.4g} ± {gain['std']:.2g}{_spaced(gain['unit'])}"
        if gain["unknown"] is None
        else ""
    )
    return f"{known} (one standard deviation{formal})" if known else str(gain["unknown"])


def _bands(model: IdentifiedModel) -> str | None:
    """What the standard deviations leave out."""
    if "candidates" not in model.provenance:
        return band_says(model)
    # Coefficients of true plants lay many deviations off where the criterion chose another order.
    criterion, orders = model.provenance["criterion"], model.provenance["orders"]
    return (
        f"as if the plant were of the orders that {criterion} chose from the data ({orders}): the"
        " doubt of that choice is not in them, and the plant's coefficients may lie many"
        " deviations off; say `order` where it is known"
    )


def _series_text(model: IdentifiedModel, result: dict[str, Any]) -> str:
    """The same of a model without an input: its noise shaping alone."""
    A = np.ones(1) if model.noise_denominator is None else model.noise_denominator
    lines = [
        (
            f"{model.method}: {_named(model.output_name, model.output_unit)}, {result['samples']}"
            f" samples of {model.sample_time:g} s"
        ),
        (
            f"  order             {len(A) - 1}: A = [{', '.join(f'{value:.4g}' for value in A)}],"
            " descending powers of z"
        ),
        (
            f"  innovation        {math.sqrt(model.noise_variance):.4g}{_spaced(model.output_unit)}"
            " (standard deviation)"
        ),
        *(f"  warning           {text}" for text in model.warnings),
    ]
    return "\n".join(
        [*lines, *([f"  written to        {result['file']}"] if result["file"] else [])]
    )


def _named(channel: str, unit: str) -> str:
    return f"{channel} [{unit}]" if unit else channel


def _spaced(unit: str) -> str:
    return f" {unit}" if unit else ""


def _gain_unit(model: IdentifiedModel) -> str:
    """Output unit over input unit, behind a blank; nothing where neither channel has one."""
    return (
        f" {model.output_unit or '1'}/{model.input_unit or '1'}"
        if model.output_unit or model.input_unit
        else ""
    )


def _fits(values: Sequence[float | None]) -> str:
    return ", ".join("unknown" if value is None else f"{value:.2f} %" for value in values)
