"""`residuum compare`: how large is a model's error on records, is it structured, and where does it
lie?
"""

import typer

from residuum.library.questions.compare import Compare
from residuum.service.commands.asked import asks
from residuum.service.commands.fmu_process import model_for
from residuum.service.commands.own_catalogue import OwnCatalogue
from residuum.service.commands.plot_option import Plot, check_plot, drawn
from residuum.service.commands.records import ModelSource, Reading, RecordFiles, reads
from residuum.service.commands.report import AsJson, report
from residuum.service.work.worker_pool import keep_large_arrays

app = typer.Typer(add_completion=False)


@app.command(name="compare")
@asks()
@reads()
def compare_command(
    model: ModelSource,
    records: RecordFiles,
    asked: Compare,
    reading: Reading,
    catalogue: OwnCatalogue = None,
    plot: Plot = None,
    as_json: AsJson = False,
) -> None:
    """Compare a model with records. Its parameters are not changed."""
    # Refused before the records are read: a picture that cannot be written must not cost the work.
    check_plot(plot)
    loaded = reading.for_model(records)
    # This process ends with its answer: pages that are given back and taken anew cost a fifth of
    # the time that explaining takes. A service does the opposite, so the library itself decides
    # nothing.
    keep_large_arrays()
    given = model_for(model)
    comparison = given.compare(loaded, map=reading.signals, **asked.model_dump())
    report(
        comparison.to_dict() | drawn(plot, [comparison], f"{model} compared"),
        str(comparison),
        as_json=as_json,
    )
