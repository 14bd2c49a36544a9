"""`residuum estimate`: the parameters of a model from records, its structure as it is."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from residuum.identification.discrepancy.input_timing import at_likelier_timing
from residuum.identification.errors import BadInput
from residuum.identification.physics import (
    Estimate,
    Experiment,
    PhysicalModel,
    estimate,
    estimate_by_likelihood,
    load_model,
    match,
    windows,
    with_coloured_noise,
    write_model,
)
from residuum.identification.record import Record
from residuum.service.commands.output_file import check_output_file
from residuum.service.commands.records import ChannelMap, RecordFiles, Resample, SampleTime, Units, load_records, pairs
from residuum.service.commands.report import AsJson, report

app = typer.Typer(add_completion=False)

Method = Callable[[PhysicalModel, Sequence[Experiment], int], Estimate]

METHODS: dict[str, Method] = {
    "simulation": lambda model, experiments, _: _with_honest_band(model, experiments),
    "prediction": lambda model, experiments, steps: _with_honest_band(model, [w for e in experiments for w in windows(e, steps)]),
    "kalman": lambda model, experiments, _: estimate_by_likelihood(model, experiments),
}


@app.command(name="estimate")
def estimate_command(
    model: Annotated[str, typer.Argument(metavar="MODEL", help="A built-in model or a model file.")],
    records: RecordFiles,
    out: Annotated[Path, typer.Option(help="File for the model with the estimated parameters (YAML).")],
    method: Annotated[str, typer.Option(help=f"What error is minimised: {', '.join(METHODS)}.")] = "simulation",
    steps: Annotated[int, typer.Option(min=2, help="Samples predicted ahead (method prediction).")] = 50,
    hold: Annotated[str, typer.Option(help="Inputs between samples: auto, linear or zero-order.")] = "auto",
    channel_map: ChannelMap = None,
    resample: Resample = False,
    sample_time: SampleTime = None,
    unit: Units = None,
    as_json: AsJson = False,
) -> None:
    """Estimate the free parameters; a note `# split: 0.7` in a record keeps its rest for validation."""
    if method not in METHODS:
        raise BadInput(f"--method {method!r}: there is none of this name; known are {', '.join(METHODS)}")
    check_output_file(out)
    loaded = load_records(records, resample=resample, sample_time=sample_time, units=unit)
    start, experiments = match(load_model(model), loaded, pairs("--map", channel_map), hold)
    parts = [_estimation_part(e, record) for e, record in zip(experiments, loaded, strict=True)]
    if hold == "auto":
        turned, result = at_likelier_timing(parts, lambda tried: METHODS[method](start, tried, steps))
        experiments = [replace(e, hold=part.hold) for e, part in zip(experiments, turned, strict=True)]
    else:
        result = METHODS[method](start, parts, steps)
    held_out = _held_out_error(result.model, experiments, loaded)
    out.write_text(write_model(result.model), encoding="utf-8")
    found = estimate_json(model, records, result) | {"method": method, "held_out_rmse": held_out, "model_file": str(out)}
    report(found, _text(found), as_json=as_json)


def estimate_json(model: str, records: Sequence[Path], result: Estimate) -> dict[str, Any]:
    """The `estimate` object of the command line and the HTTP interface."""
    declared = result.model.all_parameters
    values = zip(result.parameters, result.theta, result.std, strict=True)
    fit = _fit_percent(result)
    return {
        "model": model,
        "records": [str(file) for file in records],
        "parameters": {
            name: {"value": value, "std": std, "unit": declared[name].unit, "at_bound": name in result.at_bound}
            for name, value, std in values
        },
        "outputs": {
            name: {"unit": output.unit, "rmse": result.rmse[k], "fit_percent": fit[k]}
            for k, (name, output) in enumerate(result.model.outputs.items())
            if np.isfinite(result.rmse[k])
        },
        "flat_directions": [
            {"parameters": list(flat.parameters), "relative_weights": list(flat.weights)} for flat in result.flat
        ],
        "converged": result.converged,
        "iterations": result.iterations,
    }


def _with_honest_band(model: PhysicalModel, experiments: Sequence[Experiment]) -> Estimate:
    return with_coloured_noise(estimate(model, experiments), experiments)


def _estimation_part(experiment: Experiment, record: Record) -> Experiment:
    return experiment if record.split is None else experiment.window(0, max(2, round(record.split * experiment.n)))


def _held_out_error(
    model: PhysicalModel, experiments: Sequence[Experiment], records: Sequence[Record]
) -> dict[str, float] | None:
    """RMS error of each output on the parts after the split, simulated with initial states of their own."""
    kept = [(e, r.split) for e, r in zip(experiments, records, strict=True) if r.split is not None]
    rests = [e.window(round(split * e.n), e.n) for e, split in kept if e.n - round(split * e.n) >= 2]
    if not rests:
        return None
    rmse = estimate(model, rests, free=()).rmse
    return {name: float(rmse[k]) for k, name in enumerate(model.outputs) if np.isfinite(rmse[k])}


def _fit_percent(result: Estimate) -> list[float]:
    residuals, predicted = np.concatenate(result.residuals), np.concatenate(result.predicted)
    fits = []
    for r, y_hat in zip(residuals.T, predicted.T, strict=True):
        there = np.isfinite(r)
        y = (r + y_hat)[there]
        spread = float(np.linalg.norm(y - y.mean())) if there.any() else 0.0
        fits.append(100.0 * (1.0 - float(np.linalg.norm(r[there])) / spread) if spread > 0 else float("nan"))
    return fits


def _text(found: dict[str, Any]) -> str:
    lines = [
        f"{name} = {p['value']:.6g} ± {p['std']:.2g} {p['unit']}" + ("  (at its bound)" if p["at_bound"] else "")
        for name, p in found["parameters"].items()
    ]
    lines += [
        f"{name}: RMS error {o['rmse']:.4g} {o['unit']}, fit {o['fit_percent']:.2f} %" for name, o in found["outputs"].items()
    ]
    lines += [f"the data cannot tell apart: {', '.join(flat['parameters'])}" for flat in found["flat_directions"]]
    if not found["converged"]:
        lines.append("the estimation has not converged")
    return "\n".join([*lines, f"written to {found['model_file']}"])
