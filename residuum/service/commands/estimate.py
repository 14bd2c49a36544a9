"""`residuum estimate`: the parameters of a model from records, its structure as it is."""

from pathlib import Path
from typing import Annotated

import typer

from residuum.library.answers.estimation import estimate_text
from residuum.library.questions.estimate import Estimate
from residuum.service.cli import ANSWER_IS_NO
from residuum.service.commands.asked import asks
from residuum.service.commands.fmu_process import model_for
from residuum.service.commands.output_file import check_output_file
from residuum.service.commands.own_catalogue import OwnCatalogue
from residuum.service.commands.records import ModelSource, Reading, RecordFiles, reads
from residuum.service.commands.report import AsJson, report

app = typer.Typer(add_completion=False)

_NOT_WRITTEN = "not written (--anyway writes the model all the same)"


@app.command(name="estimate")
@asks()
@reads()
def estimate_command(
    model: ModelSource,
    records: RecordFiles,
    out: Annotated[
        Path, typer.Option(help="File for the model with the estimated parameters (YAML).")
    ],
    asked: Estimate,
    reading: Reading,
    catalogue: OwnCatalogue = None,
    as_json: AsJson = False,
) -> None:
    """Estimate the free parameters. The note `# split: 0.7` in a record keeps the last 30 % for
    validation.
    """
    check_output_file(out)
    loaded = reading.for_model(records)
    estimation = model_for(model).estimate(loaded, map=reading.signals, **asked.model_dump())
    # Values that a search left on its way are no model. One at a bound is written, with status 1: a
    # first model that lacks physics fits so, and the next question begins with it.
    written = asked.anyway or not estimation.unsettled
    if written:
        estimation.model.save(out)
    answer = estimation.to_dict() | {"model_file": str(out) if written else None}
    report(
        answer, estimate_text(answer) + ("" if written else f"\n{_NOT_WRITTEN}"), as_json=as_json
    )
    if not estimation.converged:
        raise typer.Exit(ANSWER_IS_NO)
