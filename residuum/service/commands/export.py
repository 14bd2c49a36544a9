"""`residuum export`: a model file as source code for another tool."""

from pathlib import Path
from typing import Annotated

import typer

from residuum.identification.errors import BadInput
from residuum.library.whole_file import write_whole
from residuum.service.commands.output_file import check_output_file
from residuum.service.commands.report import AsJson, report

app = typer.Typer(add_completion=False)

_TARGETS = ("c", "python", "matlab", "modelica")


@app.command(name="export")
def export_command(
    model: Annotated[str, typer.Argument(metavar="MODEL", help="A built-in model or a model file.")],
    to: Annotated[str, typer.Option(metavar="|".join(_TARGETS), help="What to write.")],
    out: Annotated[Path, typer.Option(help="File to write.")],
    as_json: AsJson = False,
) -> None:
    """Write a model, effects included, as source code for another tool."""
    if to not in _TARGETS:
        raise BadInput(f"--to {to!r}: there is no such target; known are {', '.join(_TARGETS)}")
    check_output_file(out)
    from residuum.identification.physics import load_model  # noqa: PLC0415  SymPy is imported for this command alone
    from residuum.identification.physics.export import EXPORTS, explicit  # noqa: PLC0415

    made = explicit(load_model(model))
    write_whole(out, EXPORTS[to](made))
    result = {
        "model": model,
        "to": to,
        "file": str(out),
        "states": list(made.states),
        "inputs": list(made.inputs),
        "outputs": list(made.outputs),
        "parameters": dict(made.values),
    }
    report(result, f"{model} written as {to}: {out}", as_json=as_json)
