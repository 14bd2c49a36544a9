"""`residuum export`: a model file for another tool."""

from pathlib import Path
from typing import Annotated, Any

import typer

from residuum.identification.errors import BadInput
from residuum.library.whole_file import write_whole
from residuum.nearest_names import known_names
from residuum.service.commands.output_file import check_output_file
from residuum.service.commands.records import ModelSource
from residuum.service.commands.report import AsJson, report

app = typer.Typer(add_completion=False)

_TARGETS = ("c", "python", "matlab", "modelica", "fmu")


@app.command(name="export")
def export_command(
    model: ModelSource,
    to: Annotated[str, typer.Option(metavar="|".join(_TARGETS), help="What to write.")],
    out: Annotated[Path, typer.Option(help="File to write.")],
    as_json: AsJson = False,
) -> None:
    """Write a model, effects included, for another tool: source code, or an FMU (FMI 2.0) with
    sources and a library.
    """
    # Named here instead of asked of `EXPORTS`: a mistyped target is refused without loading SymPy.
    if to not in _TARGETS:
        raise BadInput(f"--to {to!r}: there is no such target; {known_names(to, _TARGETS)}")
    check_output_file(out)
    # SymPy is imported for this command alone
    from residuum.identification.physics import load_model  # noqa: PLC0415
    from residuum.identification.physics.export import EXPORTS, explicit  # noqa: PLC0415

    explicit_model = explicit(load_model(model))
    content, binary = _fmu(explicit_model) if to == "fmu" else (EXPORTS[to](explicit_model), {})
    write_whole(out, content)
    result = {
        "model": model,
        "to": to,
        "file": str(out),
        "states": list(explicit_model.states),
        "inputs": list(explicit_model.inputs),
        "outputs": list(explicit_model.outputs),
        "parameters": dict(explicit_model.values),
        "components": {key: part.title for key, part in explicit_model.components.items()},
        **binary,
    }
    remark = f" ({binary.get('library') or binary['without_library']})" if binary else ""
    report(result, f"{model} written as {to}: {out}{remark}", as_json=as_json)


def _fmu(explicit_model: Any) -> tuple[bytes, dict[str, str | None]]:
    """The FMU's bytes, and the folder of its library or why there is none."""
    from residuum.identification.physics.export.fmu_file import fmu  # noqa: PLC0415  as above

    packed = fmu(explicit_model)
    return packed.content, {"library": packed.library, "without_library": packed.why or None}
