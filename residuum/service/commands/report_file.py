"""`residuum report`: records, and a model beside them, as one page that can be sent."""

from pathlib import Path
from typing import Annotated

import typer

from residuum.identification.errors import BadInput
from residuum.identification.physics import BUILT_IN
from residuum.library.model import model as read_model
from residuum.library.record import shown
from residuum.library.result import Result
from residuum.library.whole_file import write_whole
from residuum.service.commands.output_file import check_output_file
from residuum.service.commands.records import Reading, reads
from residuum.service.commands.report import AsJson, report, tell_progress
from residuum.service.results.report_page import analysis_page

app = typer.Typer(add_completion=False)
_MODEL_FILES = (".yaml", ".yml")


@app.command(name="report")
@reads()
def report_command(
    files: Annotated[
        list[str],
        typer.Argument(
            metavar="[MODEL] RECORD…",
            help="Record files; before them a model to hold against them.",
        ),
    ],
    out: Annotated[Path, typer.Option(help="The HTML file to write.")],
    reading: Reading,
    explain: Annotated[
        bool, typer.Option("--explain", help="Also say which physical effect the model lacks.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Write records, and how well a model meets them, as one page that opens offline and can be
    sent.
    """
    # By the ending alone: a record that cannot be read is then refused as a record, with the way on
    # that its reader names.
    model, records = (files[0], files[1:]) if _is_model(files[0]) else (None, files)
    if not records:
        raise BadInput(
            "report: names no record; write `residuum report MODEL RECORD… --out FILE.html`"
        )
    if explain and model is None:
        raise BadInput("report: --explain needs a model; name it before the records")
    check_output_file(out)
    loaded = reading.for_model([Path(file) for file in records])
    answers: list[Result] = []
    if model is not None:
        given, channels = read_model(model), reading.signals
        if explain:
            # It holds the comparison, too: the page shows both.
            answers.append(given.explain(loaded, map=channels, progress=tell_progress))
        else:
            answers.append(given.compare(loaded, map=channels))
    title = f"{model}: {', '.join(records)}" if model else ", ".join(records)
    write_whole(out, analysis_page(title, [shown(record) for record in loaded], answers))
    report(
        {"file": str(out), "model": model, "records": records}, f"{out}: written", as_json=as_json
    )


def _is_model(name: str) -> bool:
    """Whether a name is a built-in model's or a model file's; a record has another ending."""
    return name in BUILT_IN or Path(name).suffix.lower() in _MODEL_FILES
