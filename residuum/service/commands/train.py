"""`residuum train`: records → a stored, trained diagnoser."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import typer

from residuum.diagnosis.diagnosers import diagnoser_class, untrained
from residuum.diagnosis.diagnosers.base import Diagnoser
from residuum.diagnosis.diagnosers.gate_actuator import GateActuator
from residuum.diagnosis.learning.labels_file import read_labels
from residuum.identification.errors import BadInput
from residuum.library.answers.validation import validated, validation_says
from residuum.library.questions.score import Train
from residuum.service.commands.asked import asks
from residuum.service.commands.output_file import check_output_file
from residuum.service.commands.records import Reading, RecordFiles, reads
from residuum.service.commands.report import AsJson, report
from residuum.service.commands.score import DiagnoserName

app = typer.Typer(add_completion=False)
_LABELS = (
    "CSV of `record,label`, or `record,label,exemplar` (gate-actuator: which actuator it comes"
    " from, so that the limits hold for one never seen); without it every record is healthy."
)


@app.command()
@asks()
@reads()
def train(
    diagnoser: DiagnoserName,
    records: RecordFiles,
    out: Annotated[Path, typer.Option(help="File for the trained diagnoser.")],
    reading: Reading,
    asked: Train,
    labels: Annotated[Path | None, typer.Option(help=_LABELS)] = None,
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
    kind = diagnoser_class(diagnoser)
    judge = untrained(kind, **asked.settings)
    check_output_file(out)
    names, exemplars = read_labels(labels, records) if labels else (None, None)
    loaded = reading.named(records)
    if exemplars is not None and validate is None and not isinstance(judge, GateActuator):
        raise BadInput(
            f"{labels}: only the gate-actuator diagnoser knows exemplars, not {diagnoser!r}; give"
            " record,label, or --validate"
        )

    def fit(unfitted: Diagnoser, indices: Sequence[int]) -> Diagnoser:
        chosen = [loaded[k] for k in indices]
        named = None if names is None else [names[k] for k in indices]
        if isinstance(unfitted, GateActuator) and exemplars is not None:
            return unfitted.fit(chosen, named, [exemplars[k] for k in indices])
        return unfitted.fit(chosen, named)

    fit(judge, range(len(loaded))).save(out)
    validation = None
    if validate is not None:
        truth = names or ["healthy"] * len(loaded)
        objects = exemplars or [str(k) for k in range(len(loaded))]
        validation = validated(
            validate,
            lambda indices: fit(untrained(kind, **asked.settings), indices),
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
    learned = judge.learned()
    human = "\n".join(
        [
            f"{diagnoser}: trained on {count}, {seconds:.4g} s of data → {out}",
            *learned.pop("says", []),
            *validation_says(validation),
        ]
    )
    report(result | learned, human, as_json=as_json)
