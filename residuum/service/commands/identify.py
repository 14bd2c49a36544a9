"""`residuum identify`: a record → a linear model with its uncertainty."""

from pathlib import Path
from typing import Annotated

import typer

from residuum.library.plant import identified
from residuum.library.questions.identify import Identify
from residuum.service.commands.asked import asks
from residuum.service.commands.output_file import check_output_file
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
)
from residuum.service.commands.report import AsJson, report, told

app = typer.Typer(add_completion=False)


@app.command()
@asks()
def identify(
    records: RecordFiles,
    asked: Identify,
    out: Annotated[Path | None, typer.Option(help="File for the identified model (JSON).")] = None,
    channel_map: ChannelMap = None,
    resample: Resample = False,
    mapping: MappingFile = None,
    dbc: DbcFile = None,
    sample_time: SampleTime = None,
    unit: Units = None,
    plot: Plot = None,
    as_json: AsJson = False,
) -> None:
    """Identify a linear model from INPUT to OUTPUT; the note `# split: 0.7` in a record keeps the last 30 % for validation."""
    if out is not None:
        check_output_file(out)
    check_plot(plot)
    loaded = load_records(
        records, mapping=mapping, dbc=dbc, resample=resample, sample_time=sample_time, units=unit, channel_map=channel_map
    )
    plant = identified(loaded, asked, told)
    if out is not None:
        plant.save(out)
    title = f"{', '.join(asked.outputs)} identified"
    result = plant.to_dict() | {"file": None if out is None else str(out)} | drawn(plot, [plant], title)
    report(result, plant.report(result), as_json=as_json)
