"""`residuum explain`: which physical effect is missing in a model?"""

import typer

from residuum.library.questions.missing_effect import Explain
from residuum.service.commands.asked import asks
from residuum.service.commands.fmu_process import model_for
from residuum.service.commands.own_catalogue import OwnCatalogue
from residuum.service.commands.plot_option import Plot, check_plot, drawn
from residuum.service.commands.records import ModelSource, Reading, RecordFiles, reads
from residuum.service.commands.report import AsJson, report, tell_progress
from residuum.service.work.worker_pool import keep_large_arrays

app = typer.Typer(add_completion=False)


@app.command(name="explain")
# The question's catalogue is a text in every door; here it is a file, which must be read before the
# model that may name its effects.
@asks(without=("catalogue",))
@reads()
def explain_command(
    model: ModelSource,
    records: RecordFiles,
    asked: Explain,
    reading: Reading,
    catalogue: OwnCatalogue = None,
    plot: Plot = None,
    as_json: AsJson = False,
) -> None:
    """Name the physical effect that is missing in a model, from records."""
    check_plot(plot)
    loaded = reading.for_model(records)
    channels = reading.signals
    given = model_for(model)
    # See `compare`: this process ends with its answer.
    keep_large_arrays()
    explanation = given.explain(loaded, map=channels, progress=tell_progress, **asked.model_dump())
    told_of = drawn(plot, [explanation], f"What {model} lacks")
    report(explanation.to_dict() | told_of, str(explanation), as_json=as_json)
