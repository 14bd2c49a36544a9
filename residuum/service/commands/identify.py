"""`residuum identify`: a record → a linear model with its uncertainty."""

from pathlib import Path
from typing import Annotated

import typer

from residuum.identification.errors import BadInput
from residuum.library.answers.identification import identification_text
from residuum.library.identification_methods import CRITERIA, METHODS, Request, check_method
from residuum.library.plant import identified
from residuum.service.commands.output_file import check_output_file
from residuum.service.commands.records import ChannelMap, MappingFile, RecordFiles, Resample, SampleTime, Units, load_records
from residuum.service.commands.report import AsJson, report, told

app = typer.Typer(add_completion=False)


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
    mapping: MappingFile = None,
    sample_time: SampleTime = None,
    unit: Units = None,
    as_json: AsJson = False,
) -> None:
    """Identify a linear model from INPUT to OUTPUT; a note `# split: 0.7` in a record keeps its rest for validation."""
    check_method(method, criterion)
    if out is not None:
        check_output_file(out)
    request = Request(input, output, order, _delay(delay), kernel, _noise_variance(noise_variance), not no_offset, criterion)
    loaded = load_records(
        records, mapping=mapping, resample=resample, sample_time=sample_time, units=unit, channel_map=channel_map
    )
    plant = identified(loaded, request, method, told)
    if out is not None:
        plant.save(out)
    result = plant.to_dict() | {"file": None if out is None else str(out)}
    report(result, identification_text(plant.identified, result), as_json=as_json)


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
