"""`residuum train`: records → a stored, trained diagnoser."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import typer

from residuum.diagnosis.diagnosers.base import Diagnoser
from residuum.diagnosis.diagnosers.gate_actuator import GateActuator
from residuum.diagnosis.learning.labels_file import read_labels
from residuum.identification.errors import BadInput
from residuum.library.answers.validation import validated, validation_says
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
from residuum.service.commands.records import Reading, RecordFiles, reads
from residuum.service.commands.report import AsJson, report

app = typer.Typer(add_completion=False)
_LABELS = (
    "CSV of `record,label`, or `record,label,exemplar` (gate-actuator: which actuator it comes"
    " from, so that the limits hold for one never seen); without it every record is healthy."
)


@app.command()
@reads()
def train(
    diagnoser: DiagnoserName,
    records: RecordFiles,
    out: Annotated[Path, typer.Option(help="File for the trained diagnoser.")],
    reading: Reading,
    labels: Annotated[Path | None, typer.Option(help=_LABELS)] = None,
    speed_rpm: SpeedRpm = None,
    orders: Orders = None,
    hertz: Hertz = None,
    method: Method = None,
    model: ModelName = None,
    fix_undetermined: FixUndetermined = False,
    false_alarms_per_day: FalseAlarms = None,
    validate: Annotated[
        Literal["object-wise", "bootstrap"] | None,
        typer.Option(
            help=(
                "Also validate on exemplars (or records) left out of the training: each in turn, or"
                " by the .632+ bootstrap."
            )
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Train a diagnoser on records and store it for `score --baseline`."""
    of_model = model_settings(model, fix_undetermined, false_alarms_per_day)
    untrained = new_diagnoser(
        diagnoser, diagnoser_settings(speed_rpm, orders, hertz, method) | of_model
    )
    check_output_file(out)
    names, exemplars = read_labels(labels, records) if labels else (None, None)
    loaded = reading.named(records)
    if exemplars is not None and validate is None and not isinstance(untrained, GateActuator):
        raise BadInput(
            f"{labels}: only the gate-actuator diagnoser knows exemplars, not {diagnoser!r}; give"
            " record,label, or --validate"
        )
    settings = diagnoser_settings(speed_rpm, orders, hertz, method) | of_model

    def fit(judge: Diagnoser, indices: Sequence[int]) -> Diagnoser:
        chosen = [loaded[k] for k in indices]
        named = None if names is None else [names[k] for k in indices]
        if isinstance(judge, GateActuator) and exemplars is not None:
            return judge.fit(chosen, named, [exemplars[k] for k in indices])
        return judge.fit(chosen, named)

    fit(untrained, range(len(loaded))).save(out)
    validation = None
    if validate is not None:
        truth = names or ["healthy"] * len(loaded)
        objects = exemplars or [str(k) for k in range(len(loaded))]
        validation = validated(
            validate,
            lambda indices: fit(new_diagnoser(diagnoser, settings), indices),
            loaded,
            truth,
            objects,
        )
    seconds = sum(record.duration for record in loaded)
    result = {
        "diagnoser": diagnoser,
        "records": [str(file) for file in records],
        "labels": names,
        "seconds_of_data": seconds,
        "file": str(out),
        "validation": validation,
    }
    count = "1 record" if len(loaded) == 1 else f"{len(loaded)} records"
    learned = untrained.learned()
    human = "\n".join(
        [
            f"{diagnoser}: trained on {count}, {seconds:.4g} s of data → {out}",
            *learned.pop("says", []),
            *validation_says(validation),
        ]
    )
    report(result | learned, human, as_json=as_json)
