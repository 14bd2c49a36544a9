"""`residuum simulate`: a record of a virtual machine, with hidden effects and faults, as a file."""

from pathlib import Path
from typing import Annotated, Any

import typer

from residuum.identification.record_formats import WRITERS, write_record
from residuum.library.questions.simulate import Simulate
from residuum.library.virtual_machine import simulated
from residuum.service.commands.asked import asks
from residuum.service.commands.output_file import check_output_file
from residuum.service.commands.report import AsJson, report
from residuum.simulation import MACHINES

app = typer.Typer(add_completion=False)


@app.command()
@asks()
def simulate(
    machine: Annotated[str, typer.Argument(help=f"One of {', '.join(MACHINES)}.")],
    out: Annotated[
        Path,
        typer.Option(
            help=f"Record file to write; the ending says the format ({', '.join(WRITERS)})."
        ),
    ],
    asked: Simulate,
    as_json: AsJson = False,
) -> None:
    """Write a record of a simulated machine. The report says what is hidden in it; the file does
    not.
    """
    check_output_file(out)
    # The truth is told apart from the record: a file that held it would give every analysis the
    # answer.
    record, truth = simulated(machine, asked)
    write_record(record, out)
    result = {
        "file": str(out),
        "samples": record.n,
        "sample_time": record.sample_time,
        "channels": dict(record.units),
    }
    report({**result, "truth": truth}, _human(result, truth), as_json=as_json)


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
