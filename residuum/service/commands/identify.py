"""`residuum identify`: a record → a linear model with its uncertainty."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from residuum.identification.errors import BadInput
from residuum.identification.kernel_based.delay import estimate_delay
from residuum.identification.kernel_based.impulse_response import identify_impulse_response
from residuum.identification.kernel_based.marginal_bands import band_says
from residuum.identification.linear_models.fit import simulation_fit
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.identified_model_file import save_identified
from residuum.identification.linear_models.prediction_error import CRITERIA, STRUCTURES
from residuum.identification.linear_models.prediction_error import identify as identify_prediction_error
from residuum.identification.record import Record
from residuum.service.commands.output_file import check_output_file
from residuum.service.commands.records import ChannelMap, RecordFiles, Resample, SampleTime, Units, load_records
from residuum.service.commands.report import AsJson, progress, report

app = typer.Typer(add_completion=False)


@dataclass(frozen=True)
class Request:
    """What the user asked of an identification method; None = the method's own choice."""

    input: str
    output: str
    order: int | None
    delay: int | None
    kernel: str
    noise_variance: str | float
    offset: bool
    criterion: str = "bic"


def _kernel(records: Sequence[Record], request: Request) -> IdentifiedModel:
    order = 100 if request.order is None else request.order
    delay = request.delay
    if delay is None:
        delay = estimate_delay(records, request.input, request.output, kernel=request.kernel, offset=request.offset).delay
    return identify_impulse_response(
        records,
        request.input,
        request.output,
        kernel=request.kernel,
        order=order,
        delay=delay,
        noise_variance=request.noise_variance,
        offset=request.offset,
    )


def _parametric(structure: str) -> Callable[[Sequence[Record], Request], IdentifiedModel]:
    def identify_structure(records: Sequence[Record], request: Request) -> IdentifiedModel:
        delay = request.delay
        if delay is None:
            delay = estimate_delay(records, request.input, request.output, kernel=request.kernel, offset=request.offset).delay
        return identify_prediction_error(
            STRUCTURES[structure],
            records,
            request.input,
            request.output,
            order=request.order,
            delay=delay,
            offset=request.offset,
            criterion=request.criterion,
        )

    return identify_structure


METHODS: dict[str, Callable[[Sequence[Record], Request], IdentifiedModel]] = {
    "kernel": _kernel,
    **{name: _parametric(name) for name, structure in STRUCTURES.items() if structure.has_input},
}


@app.command()
def identify(
    records: RecordFiles,
    input: Annotated[str, typer.Option("--input", metavar="CH", help="Channel of the input.")],
    output: Annotated[str, typer.Option("--output", metavar="CH", help="Channel of the output.")],
    out: Annotated[Path | None, typer.Option(help="File for the identified model (JSON).")] = None,
    method: Annotated[str, typer.Option(help=f"One of {', '.join(METHODS)}.")] = "kernel",
    kernel: Annotated[str, typer.Option(help="Prior of the impulse response: tc, dc, ss or di.")] = "tc",
    order: Annotated[
        int | None, typer.Option(help="Impulse-response length (kernel: 100) or model order (others: by --criterion).")
    ] = None,
    criterion: Annotated[str, typer.Option(help=f"What chooses the model order: one of {', '.join(CRITERIA)}.")] = "bic",
    delay: Annotated[str, typer.Option(help="Samples before the input acts, or `estimate`.")] = "1",
    noise_variance: Annotated[str, typer.Option(help="`marginal`, `least-squares`, or a number [output unit²].")] = "marginal",
    no_offset: Annotated[bool, typer.Option("--no-offset", help="The signals are deviations: fit no constant level.")] = False,
    channel_map: ChannelMap = None,
    resample: Resample = False,
    sample_time: SampleTime = None,
    unit: Units = None,
    as_json: AsJson = False,
) -> None:
    """Identify a linear model from INPUT to OUTPUT; a note `# split: 0.7` in a record keeps its rest for validation."""
    if method not in METHODS:
        raise BadInput(f"--method {method!r}: there is none of this name; known are {', '.join(METHODS)}")
    if criterion not in CRITERIA:
        raise BadInput(f"--criterion {criterion!r}: there is none of this name; known are {', '.join(CRITERIA)}")
    if out is not None:
        check_output_file(out)
    request = Request(input, output, order, _delay(delay), kernel, _noise_variance(noise_variance), not no_offset, criterion)
    loaded = load_records(records, resample=resample, sample_time=sample_time, units=unit, channel_map=channel_map)
    estimation, held_out = _split(loaded)
    progress(f"identifying from {sum(record.n for record in estimation)} samples", 0.1)
    model = METHODS[method](estimation, request)
    progress("simulating beside the records", 0.9)
    if out is not None:
        save_identified(model, out)
    result = _json(model, method, estimation, held_out, out)
    report(result, _human(model, result), as_json=as_json)


def _split(records: Sequence[Record]) -> tuple[list[Record], list[Record]]:
    """Each record's part for estimation, and the rest of those with a split note."""
    cuts = [record.n if record.split is None else max(1, round(record.split * record.n)) for record in records]
    estimation = [record.window(0, cut) for record, cut in zip(records, cuts, strict=True)]
    return estimation, [record.window(cut, record.n) for record, cut in zip(records, cuts, strict=True) if cut < record.n]


def _delay(text: str) -> int | None:
    if text == "estimate":
        return None
    if not text.isdecimal():
        raise BadInput(f"--delay {text!r}: must be a number of samples ≥ 0, or estimate")
    return int(text)


def _noise_variance(text: str) -> str | float:
    try:
        return float(text)
    except ValueError:
        return text


def _json(
    model: IdentifiedModel, method: str, estimation: Sequence[Record], held_out: Sequence[Record], out: Path | None
) -> dict[str, Any]:
    """The contract's `identify` object, and what else a program may want."""
    return {
        "method": method,
        "order": model.order,
        "sample_time": model.sample_time,
        "impulse_response": model.impulse_response,
        "std": model.std,
        "std_says": band_says(model),
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
        "file": None if out is None else str(out),
    }


def _fit(model: IdentifiedModel, record: Record) -> float | None:
    try:
        return simulation_fit(model, record)
    except BadInput:
        return None  # a part too short to have a fit is no reason to withhold the model


def _human(model: IdentifiedModel, result: dict[str, Any]) -> str:
    gain_unit = _gain_unit(model)
    gain = float(model.frequency_response(0.0).real)
    gain_std = math.sqrt(max(float(model.frequency_covariance(0.0)[0, 0, 0]), 0.0))
    peak = int(np.argmax(np.abs(model.impulse_response)))
    lines = [
        f"{model.method}: {_named(model.input_name, model.input_unit)} → {_named(model.output_name, model.output_unit)}, "
        f"{result['samples']} samples of {model.sample_time:g} s",
        f"  impulse response  {model.order} coefficients from lag {model.delay}; largest {model.impulse_response[peak]:.4g} "
        f"± {model.std[peak]:.2g}{gain_unit} at {(model.delay + peak) * model.sample_time:g} s",
        f"  static gain       {gain:.4g} ± {gain_std:.2g}{gain_unit} (one standard deviation)",
        f"  noise             {math.sqrt(model.noise_variance):.4g}{_spaced(model.output_unit)} (standard deviation)",
        f"  fit               {_fits(result['fit_percent'])} of the estimation data",
    ]
    if result["held_out_fit_percent"]:
        lines.append(f"  held-out fit      {_fits(result['held_out_fit_percent'])}")
    if (said := band_says(model)) is not None:
        lines.append(f"  bands             {said}")
    if model.hyper_parameters:
        lines.append("  hyper-parameters  " + ", ".join(f"{name} {value:.4g}" for name, value in model.hyper_parameters.items()))
    lines += [f"  warning           {text}" for text in model.warnings]
    if result["file"]:
        lines.append(f"  written to        {result['file']}")
    return "\n".join(lines)


def _named(channel: str, unit: str) -> str:
    return f"{channel} [{unit}]" if unit else channel


def _spaced(unit: str) -> str:
    return f" {unit}" if unit else ""


def _gain_unit(model: IdentifiedModel) -> str:
    """Output unit over input unit, behind a blank; nothing where neither channel has one."""
    return f" {model.output_unit or '1'}/{model.input_unit or '1'}" if model.output_unit or model.input_unit else ""


def _fits(values: Sequence[float | None]) -> str:
    return ", ".join("unknown" if value is None else f"{value:.2f} %" for value in values)
