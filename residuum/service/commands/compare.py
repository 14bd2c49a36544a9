"""`residuum compare`: how large is a model's error on records, is it structured, and where does it lie?"""

from typing import Annotated, Any

import typer

from residuum.identification.discrepancy.compare import Comparison, compare
from residuum.identification.discrepancy.locate import Region
from residuum.identification.physics import load_model
from residuum.service.commands.records import ChannelMap, RecordFiles, Resample, SampleTime, Units, load_records, pairs
from residuum.service.commands.report import AsJson, report
from residuum.service.work.large_arrays import keep_large_arrays

app = typer.Typer(add_completion=False)


@app.command(name="compare")
def compare_command(
    model: Annotated[str, typer.Argument(metavar="MODEL", help="A built-in model or a model file.")],
    records: RecordFiles,
    channel_map: ChannelMap = None,
    resample: Resample = False,
    sample_time: SampleTime = None,
    unit: Units = None,
    as_json: AsJson = False,
) -> None:
    """Compare a model, its parameters as they are, with records."""
    loaded = load_records(records, resample=resample, sample_time=sample_time, units=unit)
    keep_large_arrays()
    comparison = compare(load_model(model), loaded, pairs("--map", channel_map))
    report(comparison_json(model, [str(file) for file in records], comparison), comparison_text(comparison), as_json=as_json)


def comparison_json(model: str, records: list[str], comparison: Comparison) -> dict[str, Any]:
    """The `compare` object of the command line and the HTTP interface."""
    return {
        "model": model,
        "records": records,
        "outputs": {
            name: {
                "unit": output.unit,
                "rmse": output.rmse,
                "fit_percent": output.fit_percent,
                "bias": output.bias,
                "noise_floor": output.noise_floor,
                "k_step": [{"samples": steps, "rmse": rmse} for steps, rmse in output.k_step.items()],
            }
            for name, output in comparison.outputs.items()
        },
        "balances": {
            name: {"unit": balance.unit, "missing_rms": balance.missing_rms, "relative_percent": balance.relative_percent}
            for name, balance in comparison.balances.items()
        },
        "structured_error": {
            "present": comparison.present,
            "p_value": comparison.p_value,
            "share": comparison.share,
            "outputs": {
                name: {"present": test.present, "p_value": test.p_value, "share": test.share}
                for name, test in comparison.structured.items()
            },
        },
        "where": [region_json(region) for region in comparison.where],
    }


def region_json(region: Region) -> dict[str, Any]:
    """One entry of `where`."""
    return {
        "axis": region.axis,
        "from": region.start,
        "to": region.stop,
        "unit": region.unit,
        "times_noise": region.times_noise,
        "share": region.share,
        "time_share": region.time_share,
        "direction": region.direction,
        "of": region.of,
        "says": region.says,
    }


def comparison_text(comparison: Comparison) -> str:
    """The short human report."""
    lines = []
    for name, output in comparison.outputs.items():
        lines.append(
            f"{name}: RMS error {output.rmse:.4g} {output.unit}, fit {output.fit_percent:.1f} %, "
            f"bias {output.bias:.3g} {output.unit}, noise floor {output.noise_floor:.3g} {output.unit}"
        )
    for name, balance in comparison.balances.items():
        lines.append(
            f"balance {name}: lacks {balance.missing_rms:.3g} {balance.unit} RMS, "
            f"{balance.relative_percent:.1f} % of what drives it"
        )
    present = comparison.present
    lines.append(
        f"structured error: {'yes' if present else 'no'} (p = {comparison.p_value:.2g}"
        + (f", {100 * comparison.share:.0f} % of the error's power)" if present else "; noise of some colour explains the error)")
    )
    lines += [f"  {region.says} (of {region.of}; {100 * region.share:.0f} % of its power)" for region in comparison.where]
    return "\n".join(lines)
