"""`residuum improve`: add effects to a model and re-estimate it."""

from pathlib import Path
from typing import Annotated

import typer

from residuum.identification.errors import BadInput
from residuum.library.answers.comparison import warning_lines
from residuum.library.answers.improvement import improvement_text
from residuum.library.questions.missing_effect import Improve
from residuum.service.commands.asked import asks
from residuum.service.commands.fmu_process import model_for
from residuum.service.commands.output_file import check_output_file
from residuum.service.commands.own_catalogue import OwnCatalogue
from residuum.service.commands.plot_option import Plot, check_plot, drawn
from residuum.service.commands.records import ModelSource, Reading, RecordFiles, reads
from residuum.service.commands.report import AsJson, report, tell_progress
from residuum.service.work.worker_pool import keep_large_arrays

app = typer.Typer(add_completion=False)


@app.command(name="improve")
# See `explain`: a file here, read before the model.
@asks(without=("catalogue",))
@reads()
def improve_command(
    model: ModelSource,
    records: RecordFiles,
    out: Annotated[
        Path, typer.Option(help="Model file to write. The model that was read is not changed.")
    ],
    asked: Improve,
    reading: Reading,
    catalogue: OwnCatalogue = None,
    plot: Plot = None,
    as_json: AsJson = False,
) -> None:
    """Add effects to a model, re-estimate it, and show its error on data not used for that."""
    # First: minutes of search were once lost to a folder that is missing.
    check_output_file(out)
    # By the file and not by its name: a link to the model would replace it as well.
    if Path(model).exists() and out.exists() and Path(model).samefile(out):
        raise BadInput(
            f"improve: --out {out} is the model itself; write a new file, the previous one is the"
            " way back"
        )
    check_plot(plot)
    loaded = reading.for_model(records)
    keep_large_arrays()
    improvement = model_for(model).improve(
        loaded, map=reading.signals, progress=tell_progress, **asked.model_dump()
    )
    # Where all that is named would make the model worse, no file is written: it would be taken for
    # an improvement.
    file = str(out) if improvement.found.helps else None
    if file:
        improvement.model.save(out)
    text = "\n".join(
        [*warning_lines(improvement.warnings), improvement_text(improvement.found, file)]
    )
    report(
        improvement.to_dict()
        | {"model_file": file}
        | drawn(plot, [improvement], f"{model} improved"),
        text,
        as_json=as_json,
    )
