"""`residuum identify`: a record → a linear model with its uncertainty."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from residuum.identification.errors import BadInput
from residuum.identification.kernel_based.multivariable import identify_multivariable
from residuum.identification.kernel_based.multivariable_file import multivariable_text as multivariable_text_of
from residuum.identification.record import Record
from residuum.library.answers.multivariable import multivariable_json, multivariable_text
from residuum.library.identification_methods import CRITERIA, LAGS, METHODS, UNCERTAINTIES, Request, check_method
from residuum.library.plant import identified, split_records
from residuum.library.whole_file import write_whole
from residuum.service.commands.output_file import check_output_file
from residuum.service.commands.plot_option import Plot, check_plot, drawn
from residuum.service.commands.records import (
    ChannelMap,
    DbcFile,
    MappingFile,
    RecordFiles,
    Resample,
    SampleTime,
    Units,
    load_records,
)
from residuum.service.commands.report import AsJson, report, told

app = typer.Typer(add_completion=False)


@app.command()
def identify(
    records: RecordFiles,
    output: Annotated[
        list[str],
        typer.Option("--output", metavar="CH", help="Channel of the output. Repeat it for several outputs: one model each."),
    ],
    input: Annotated[
        list[str] | None,
        typer.Option(
            "--input",
            metavar="CH",
            help="Channel of the input. Repeat it for several inputs that act together. Method ar needs none.",
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="File for the identified model (JSON).")] = None,
    method: Annotated[str, typer.Option(help=f"One of {', '.join(METHODS)}.")] = "kernel",
    kernel: Annotated[str, typer.Option(help="Prior of the impulse response: tc, dc, ss or di.")] = "tc",
    order: Annotated[
        int | None, typer.Option(help="Impulse-response length (kernel: 100) or model order (others: by --criterion).")
    ] = None,
    criterion: Annotated[str, typer.Option(help=f"How the model order is chosen: one of {', '.join(CRITERIA)}.")] = "bic",
    delay: Annotated[str, typer.Option(help="Samples before the input acts, or `estimate`.")] = "1",
    noise_variance: Annotated[str, typer.Option(help="`marginal`, `least-squares`, or a number [output unit²].")] = "marginal",
    uncertainty: Annotated[
        str,
        typer.Option(
            help=f"What says how far to trust the model: one of {', '.join(UNCERTAINTIES)}. All but own use data kept aside."
        ),
    ] = "own",
    noise_bound: Annotated[
        float | None,
        typer.Option(help="Largest noise of set-membership \\[output unit]; default: 1.1 times the smallest possible."),
    ] = None,
    no_offset: Annotated[
        bool, typer.Option("--no-offset", help="Fit no constant level, because the signals are deviations already.")
    ] = False,
    integrator: Annotated[
        bool,
        typer.Option("--integrator", help="The plant integrates: identify from the summed input, with a pole at one behind."),
    ] = False,
    check: Annotated[
        bool,
        typer.Option(
            "--check",
            help="Test the residuals on data kept aside (white, free of the input, model error model), and tell the error on new "
            "data by the .632+ bootstrap.",
        ),
    ] = False,
    channel_map: ChannelMap = None,
    resample: Resample = False,
    mapping: MappingFile = None,
    dbc: DbcFile = None,
    sample_time: SampleTime = None,
    unit: Units = None,
    plot: Plot = None,
    as_json: AsJson = False,
) -> None:
    """Identify a linear model from INPUT to OUTPUT; the note `# split: 0.7` in a record keeps the last 30 % for validation."""
    inputs = input or []
    check_method(method, criterion, uncertainty, inputs[0] if inputs else "")
    if out is not None:
        check_output_file(out)
    check_plot(plot)
    noise, offset = _noise_variance(noise_variance), not no_offset
    first = inputs[0] if inputs else ""
    request = Request(
        first, output[0], order, _delay(delay), kernel, noise, offset, criterion, uncertainty, noise_bound, integrator, check
    )
    loaded = load_records(
        records, mapping=mapping, dbc=dbc, resample=resample, sample_time=sample_time, units=unit, channel_map=channel_map
    )
    if len(inputs) > 1 or len(output) > 1:
        if plot is not None:
            raise BadInput("--plot: draws a model of one input and one output")
        several = _several(loaded, inputs, output, request, method, out)
        return report(several, multivariable_text(several), as_json=as_json)
    plant = identified(loaded, request, method, told)
    if out is not None:
        plant.save(out)
    result = plant.to_dict() | {"file": None if out is None else str(out)} | drawn(plot, [plant], f"{output[0]} identified")
    report(result, plant.report(result), as_json=as_json)


def _several(
    records: Sequence[Record], inputs: Sequence[str], outputs: Sequence[str], request: Request, method: str, out: Path | None
) -> dict[str, Any]:
    """One kernel model of every path; what belongs to single paths alone is refused."""
    if method != "kernel" or request.uncertainty != "own" or request.delay is None or request.integrator or request.check:
        raise BadInput(
            "several inputs or outputs: need the method kernel, a delay in samples, the model's own uncertainty, no integrator "
            "and no check"
        )
    estimation, held_out = split_records(records)
    order = LAGS if request.order is None else request.order
    model = identify_multivariable(
        estimation, inputs, outputs, kernel=request.kernel, order=order, delay=request.delay,
        noise_variance=request.noise_variance, offset=request.offset,
    )  # fmt: skip
    if out is not None:
        write_whole(out, multivariable_text_of(model))
    return multivariable_json(model, estimation, held_out) | {"file": None if out is None else str(out)}


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
