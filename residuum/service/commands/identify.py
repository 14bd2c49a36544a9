"""`residuum identify`: a record → a linear model with its uncertainty."""

from pathlib import Path
from typing import Annotated

import typer

from residuum.library.plant import identified
from residuum.library.questions.identify import Identify
from residuum.service.commands.asked import asks
from residuum.service.commands.output_file import check_output_file
from residuum.service.commands.plot_option import Plot, check_plot, drawn
from residuum.service.commands.records import Reading, RecordFiles, reads
from residuum.service.commands.report import AsJson, report, tell_progress

app = typer.Typer(add_completion=False)


@app.command()
@asks()
@reads()
def identify(
    records: RecordFiles,
    asked: Identify,
    reading: Reading,
    out: Annotated[Path | None, typer.Option(help="File for the identified model (JSON).")] = None,
    plot: Plot = None,
    as_json: AsJson = False,
) -> None:
    """Identify a linear model from INPUT to OUTPUT; the note `# split: 0.7` in a record keeps the
    last 30 % for validation.
    """
    if out is not None:
        check_output_file(out)
    check_plot(plot)
    # Renamed here: the question names inputs and outputs, where a model of balances maps its own.
    loaded = reading.named(records)
    plant = identified(loaded, asked, tell_progress)
    if out is not None:
        plant.save(out)
    title = f"{', '.join(asked.outputs)} identified"
    result = (
        plant.to_dict() | {"file": None if out is None else str(out)} | drawn(plot, [plant], title)
    )
    report(result, plant.report(result), as_json=as_json)
