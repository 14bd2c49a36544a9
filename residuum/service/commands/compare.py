"""`residuum compare`: how large is a model's error on records, is it structured, and where does it lie?"""

from typing import Annotated

import typer

from residuum.library.model import model as read
from residuum.service.commands.own_catalogue import OwnCatalogue
from residuum.service.commands.records import (
    ChannelMap,
    MappingFile,
    RecordFiles,
    Resample,
    SampleTime,
    Units,
    load_records,
    pairs,
)
from residuum.service.commands.report import AsJson, report
from residuum.service.work.large_arrays import keep_large_arrays

app = typer.Typer(add_completion=False)


@app.command(name="compare")
def compare_command(
    model: Annotated[str, typer.Argument(metavar="MODEL", help="A built-in model or a model file.")],
    records: RecordFiles,
    channel_map: ChannelMap = None,
    resample: Resample = False,
    mapping: MappingFile = None,
    sample_time: SampleTime = None,
    unit: Units = None,
    catalogue: OwnCatalogue = None,
    as_json: AsJson = False,
) -> None:
    """Compare a model, its parameters as they are, with records."""
    loaded = load_records(records, mapping=mapping, resample=resample, sample_time=sample_time, units=unit)
    keep_large_arrays()
    comparison = read(model).compare(loaded, map=pairs("--map", channel_map))
    report(comparison.to_dict(), str(comparison), as_json=as_json)
