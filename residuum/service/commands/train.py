"""`residuum train`: records → a stored, trained diagnoser."""

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from residuum.diagnosis.diagnosers.gate_actuator import GateActuator
from residuum.identification.errors import BadInput
from residuum.service.commands.diagnoser_options import (
    DiagnoserName,
    FalseAlarms,
    FixUndetermined,
    Hertz,
    Method,
    ModelName,
    Orders,
    SpeedRpm,
    diagnoser_settings,
    model_settings,
    new_diagnoser,
)
from residuum.service.commands.output_file import check_output_file
from residuum.service.commands.records import ChannelMap, MappingFile, RecordFiles, Resample, SampleTime, Units, load_records
from residuum.service.commands.report import AsJson, report

app = typer.Typer(add_completion=False)
_LABELS = (
    "CSV of `record,label`, or `record,label,exemplar` (gate-actuator: which actuator it comes from, so that the limits "
    "hold for one never seen); without it every record is healthy."
)


@app.command()
def train(
    diagnoser: DiagnoserName,
    records: RecordFiles,
    out: Annotated[Path, typer.Option(help="File for the trained diagnoser.")],
    labels: Annotated[Path | None, typer.Option(help=_LABELS)] = None,
    channel_map: ChannelMap = None,
    resample: Resample = False,
    mapping: MappingFile = None,
    sample_time: SampleTime = None,
    unit: Units = None,
    speed_rpm: SpeedRpm = None,
    orders: Orders = None,
    hertz: Hertz = None,
    method: Method = None,
    model: ModelName = None,
    fix_undetermined: FixUndetermined = False,
    false_alarms_per_day: FalseAlarms = None,
    as_json: AsJson = False,
) -> None:
    """Train a diagnoser on records and store it for `score --baseline`."""
    of_model = model_settings(model, fix_undetermined, false_alarms_per_day)
    untrained = new_diagnoser(diagnoser, diagnoser_settings(speed_rpm, orders, hertz, method) | of_model)
    check_output_file(out)
    names, exemplars = read_labels(labels, records) if labels else (None, None)
    loaded = load_records(
        records, mapping=mapping, resample=resample, sample_time=sample_time, units=unit, channel_map=channel_map
    )
    if exemplars is None:
        untrained.fit(loaded, names).save(out)
    elif isinstance(untrained, GateActuator):
        untrained.fit(loaded, names, exemplars).save(out)
    else:
        raise BadInput(f"{labels}: only the gate-actuator diagnoser knows exemplars, not {diagnoser!r}; give record,label")
    seconds = sum(record.duration for record in loaded)
    result = {
        "diagnoser": diagnoser,
        "records": [str(file) for file in records],
        "labels": names,
        "seconds_of_data": seconds,
        "file": str(out),
    }
    count = "1 record" if len(loaded) == 1 else f"{len(loaded)} records"
    learned = untrained.learned()
    human = "\n".join([f"{diagnoser}: trained on {count}, {seconds:.4g} s of data → {out}", *learned.pop("says", [])])
    report(result | learned, human, as_json=as_json)


def read_labels(file: Path, records: Sequence[Path]) -> tuple[list[str], list[str] | None]:
    """Label and exemplar of each record from a CSV of `record,label[,exemplar]` (record by file name or path)."""
    try:
        with file.open(encoding="utf-8", newline="") as rows:
            table = [[cell.strip() for cell in row] for row in csv.reader(rows) if row and not row[0].startswith("#")]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise BadInput(f"{file}: cannot be read as CSV: {error}") from None
    columns = len(table[0]) if table else 2
    if wrong := [number for number, row in enumerate(table, start=1) if len(row) != columns or columns not in (2, 3)]:
        raise BadInput(f"{file}, row {wrong[0]}: must be record,label or record,label,exemplar, the same in every row")
    known = {row[0]: row[1:] for row in table if row[:2] != ["record", "label"]}
    found: list[list[str]] = []
    for record in records:
        row = known.get(str(record), known.get(record.name))
        if row is None:
            raise BadInput(f"{file}: has no label for {record}")
        found.append(row)
    return [row[0] for row in found], [row[1] for row in found] if columns == 3 else None
