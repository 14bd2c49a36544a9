"""`residuum simulate`: a record of a virtual machine, with hidden effects and faults, as a file."""

from pathlib import Path
from typing import Annotated, Any

import typer

from residuum.identification.errors import BadInput
from residuum.identification.record_formats import WRITERS, write_record
from residuum.library.virtual_machine import simulated
from residuum.nearest_names import known_names
from residuum.service.commands.output_file import check_output_file
from residuum.service.commands.report import AsJson, report
from residuum.simulation import MACHINES
from residuum.simulation.machine import SIZES

app = typer.Typer(add_completion=False)


@app.command()
def simulate(
    machine: Annotated[str, typer.Argument(help=f"One of {', '.join(MACHINES)}.")],
    out: Annotated[
        Path,
        typer.Option(
            help=f"Record file to write; the ending says the format ({', '.join(WRITERS)})."
        ),
    ],
    effect: Annotated[
        list[str] | None,
        typer.Option(help="Hidden effect ID, ID:small|medium|large or ID:par=value,…"),
    ] = None,
    fault: Annotated[list[str] | None, typer.Option(help="Fault ID or ID:size.")] = None,
    event: Annotated[
        list[str] | None, typer.Option(help="Operating event ID or ID:size, at the next occasion.")
    ] = None,
    duration: Annotated[float | None, typer.Option(help="Length of the record \\[s].")] = None,
    seed: Annotated[int, typer.Option(help="Seed of noise, disturbances and start values.")] = 0,
    exemplar: Annotated[
        int, typer.Option(help="Number of the specimen; 0 is the nominal one.")
    ] = 0,
    profile: Annotated[
        str | None, typer.Option(help="Input profile, for machines that have several.")
    ] = None,
    rate: Annotated[
        float | None, typer.Option(help="Sampling rate [Hz], for machines that offer it.")
    ] = None,
    noise_color: Annotated[
        float | None, typer.Option(help="Correlation of the noise from sample to sample, 0 … 1.")
    ] = None,
    setting: Annotated[
        list[str] | None,
        typer.Option("--set", help="Any other setting of the machine, NAME=VALUE."),
    ] = None,
    reveal: Annotated[
        bool, typer.Option("--reveal", help="Write the truth into the file's notes.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Write a record of a simulated machine. The report says what is hidden in it; the file does
    not.
    """
    if machine not in MACHINES:
        raise BadInput(
            f"machine {machine!r}: there is none of this name; {known_names(machine, MACHINES)}"
        )
    check_output_file(out)
    given = {
        "profile": profile,
        "rate": rate,
        "noise_color": noise_color,
        **dict(map(_setting, setting or [])),
    }
    settings = {name: value for name, value in given.items() if value is not None}
    hidden, damage, happenings = (
        dict(map(_effect, effect or [])),
        dict(map(_fault, fault or [])),
        dict(map(_fault, event or [])),
    )
    record, truth = simulated(
        machine, hidden, damage, happenings, duration, seed, exemplar, reveal, settings
    )
    write_record(record, out)
    result = {
        "file": str(out),
        "samples": record.n,
        "sample_time": record.sample_time,
        "channels": dict(record.units),
    }
    report({**result, "truth": truth}, _human(result, truth), as_json=as_json)


def _setting(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals:
        raise BadInput(f"--set {text!r}: must be NAME=VALUE")
    return name.replace("-", "_"), value


def _effect(text: str) -> tuple[str, dict[str, float] | str]:
    """`id`, `id:large` or `id:par=value,…`."""
    id, _, sizes = text.partition(":")
    if sizes in SIZES:
        return id, sizes
    parts = [part.partition("=") for part in sizes.split(",")] if sizes else []
    if wrong := [name for name, equals, _ in parts if not equals]:
        raise BadInput(
            f"--effect {text!r}: {wrong[0]!r} must be par=value, or"
            f" {known_names(wrong[0], SIZES, 'one of')}"
        )
    return id, {name: _number(value, f"--effect {text!r}, {name!r}") for name, _, value in parts}


def _fault(text: str) -> tuple[str, float | None]:
    """`id` or `id:size`."""
    id, colon, size = text.partition(":")
    return id, _number(size, f"{text!r}") if colon else None


def _number(text: Any, where: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise BadInput(f"{where}: {text!r} is not a number") from None


def _human(result: dict[str, Any], truth: dict[str, Any]) -> str:
    channels = ", ".join(f"{name} [{unit or '-'}]" for name, unit in result["channels"].items())
    lines = [
        (
            f"{truth['machine']}: {result['samples']} samples of {result['sample_time']:.6g} s →"
            f" {result['file']}"
        ),
        f"channels: {channels}",
        *(
            f"hidden effect: {id} {_values(parameters)}"
            for id, parameters in truth["effects"].items()
        ),
        *(f"fault: {id}, size {size:g}" for id, size in truth["faults"].items()),
        f"true constants: {_values(truth['constants'])}",
    ]
    return "\n".join(lines)


def _values(parameters: dict[str, Any]) -> str:
    return ", ".join(f"{name} = {value:g}" for name, value in parameters.items())
