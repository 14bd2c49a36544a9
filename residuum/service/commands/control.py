"""`residuum control design`: identified models → a robust controller of fixed structure."""

import json
from pathlib import Path
from typing import Annotated

import typer

from residuum.identification.errors import BadInput
from residuum.identification.kernel_based.multivariable import is_multivariable
from residuum.library import control
from residuum.library.answers.control_design import design_text
from residuum.library.answers.multivariable_control import design_text as multivariable_text
from residuum.library.control import design_multivariable
from residuum.library.questions.control_design import DesignController
from residuum.library.whole_file import write_whole
from residuum.nearest_names import known_names
from residuum.robust_control.controller_export import LANGUAGES
from residuum.robust_control.weights.performance_weight import Infeasible
from residuum.service.cli import ANSWER_IS_NO
from residuum.service.commands.asked import asks
from residuum.service.commands.output_file import check_output_file
from residuum.service.commands.plot_option import Plot, check_plot, drawn
from residuum.service.commands.report import AsJson, report

app = typer.Typer(add_completion=False)

_NOT_OF_SEVERAL = (
    "control of several inputs and outputs: takes one model, and no --joined, --plot or --export"
)


@app.callback()
def _control() -> None:
    """Robust controllers from identified models."""


@app.command()
@asks()
def design(
    identified: Annotated[
        list[Path],
        typer.Argument(
            metavar="IDENTIFIED…",
            help=(
                "Identified models, one per operating point; or one model of as many outputs as"
                " inputs."
            ),
        ),
    ],
    out: Annotated[Path, typer.Option(help="File for the controller (JSON).")],
    asked: DesignController,
    joined: Annotated[
        Path | None,
        typer.Option(
            help=(
                "The nominal plant: a model of all operating points' records (default: the models'"
                " mean)."
            )
        ),
    ] = None,
    export: Annotated[
        tuple[str, Path] | None,
        typer.Option(
            metavar="c|st FILE", help="Also write the controller as C or structured text."
        ),
    ] = None,
    plot: Plot = None,
    as_json: AsJson = False,
) -> None:
    """Design a controller; exit status 1 when no controller of the structure meets the aim."""
    check_output_file(out)
    _check_export(export)
    check_plot(plot)
    try:
        if any(map(is_multivariable, identified)):
            if len(identified) > 1 or joined or plot or export:
                raise BadInput(_NOT_OF_SEVERAL)
            several = design_multivariable(identified[0], asked) | {"file": str(out)}
            write_whole(out, json.dumps(several, indent=1))
            return report(several, multivariable_text(several), as_json=as_json)
        controller = control.design(identified, joined=joined, **asked.model_dump())
    # An answer, not a fault: printed whole with what was asked, and status 1 as every "no" has.
    except Infeasible as no:
        described = {
            "aim": asked.aim,
            "structure": asked.structure,
            "models": [str(file) for file in identified],
        }
        report(
            described | {"feasible": False, "reason": str(no)}, f"infeasible: {no}", as_json=as_json
        )
        raise typer.Exit(ANSWER_IS_NO) from None
    result = controller.to_dict() | {"file": str(out)}
    if export is not None:
        # Files last: where the design fails, none is there that could be taken for its result.
        write_whole(export[1], LANGUAGES[export[0]](controller.difference_equation()))
        result["exported"] = str(export[1])
    write_whole(out, json.dumps(result, indent=1))
    result |= drawn(plot, [controller], f"{asked.structure} controller")
    report(result, design_text(result), as_json=as_json)


def _check_export(export: tuple[str, Path] | None) -> None:
    if export is None:
        return
    if export[0] not in LANGUAGES:
        raise BadInput(
            f"--export {export[0]!r}: there is no such language;"
            f" {known_names(export[0], LANGUAGES)}"
        )
    check_output_file(export[1])
