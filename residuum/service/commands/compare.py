"""`residuum compare`: how large is a model's error on records, is it structured, and where does it lie?"""

import typer

from residuum.library.questions.compare import Compare
from residuum.service.commands.asked import asks
from residuum.service.commands.fmu_process import model_for
from residuum.service.commands.model_source import ModelSource
from residuum.service.commands.own_catalogue import OwnCatalogue
from residuum.service.commands.plot_option import Plot, check_plot, drawn
from residuum.service.commands.records import (
    ChannelMap,
    DbcFile,
    MappingFile,
    RecordFiles,
    Resample,
    SampleTime,
    Units,
    load_records,
    signals,
)
from residuum.service.commands.report import AsJson, report
from residuum.service.work.large_arrays import keep_large_arrays

app = typer.Typer(add_completion=False)


@app.command(name="compare")
@asks()
def compare_command(
    model: ModelSource,
    records: RecordFiles,
    asked: Compare,
    channel_map: ChannelMap = None,
    resample: Resample = False,
    mapping: MappingFile = None,
    dbc: DbcFile = None,
    sample_time: SampleTime = None,
    unit: Units = None,
    catalogue: OwnCatalogue = None,
    plot: Plot = None,
    as_json: AsJson = False,
) -> None:
    """Compare a model with records. Its parameters are not changed."""
    check_plot(plot)
    loaded = load_records(
        records, mapping=mapping, dbc=dbc, resample=resample, sample_time=sample_time, units=unit, model_map=channel_map
    )
    keep_large_arrays()
    given, loaded = model_for(model, loaded, signals(channel_map))
    comparison = given.compare(loaded, map=signals(channel_map), **asked.model_dump())
    report(comparison.to_dict() | drawn(plot, [comparison], f"{model} compared"), str(comparison), as_json=as_json)
