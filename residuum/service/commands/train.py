"""`residuum train`: records → a stored, trained diagnoser."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from residuum.diagnosis.diagnosers import diagnoser_class, untrained
from residuum.diagnosis.diagnosers.base import Diagnoser
from residuum.diagnosis.diagnosers.gate_actuator import GateActuator
from residuum.diagnosis.learning.labels_file import read_labels
from residuum.identification.errors import BadInput
from residuum.identification.physics.fmu.parameter_file import named
from residuum.identification.record import Record
from residuum.library.answers.validation import validated, validation_says
from residuum.library.monitor import MODEL_BASED
from residuum.library.questions.score import Train
from residuum.service.cli import names_fmu
from residuum.service.commands.asked import asks
from residuum.service.commands.fmu_process import is_inside
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
    settings = _settings_for(diagnoser, asked)
    judge = untrained(kind, **settings)
    # Before the records are read and learned from: a mistyped folder must not cost the training.
    check_output_file(out)
    names, exemplars = read_labels(labels, records) if labels else (None, None)
    lessons = _Lessons(reading.named(records), names, exemplars)
    if exemplars is not None and validate is None and not isinstance(judge, GateActuator):
        raise BadInput(
            f"{labels}: only the gate-actuator diagnoser knows exemplars, not {diagnoser!r}; give"
            " record,label, or --validate"
        )
    # The stored diagnoser has learned from all; those of the validation are others, and are
    # dropped.
    lessons.teach(judge, range(len(records))).save(out)
    validation = None
    if validate is not None:
        validation = validated(
            validate,
            lambda indices: lessons.teach(untrained(kind, **settings), indices),
            lessons.records,
            lessons.truth,
            lessons.objects,
        )
    seconds = sum(record.duration for record in lessons.records)
    result = {
        "diagnoser": diagnoser,
        "records": [str(file) for file in records],
        "labels": names,
        "seconds_of_data": seconds,
        "file": str(out),
        "validation": validation,
    }
    count = "1 record" if len(records) == 1 else f"{len(records)} records"
    learned = judge.learned()
    human = "\n".join(
        [
            f"{diagnoser}: trained on {count}, {seconds:.4g} s of data → {out}",
            *learned.pop("says", []),
            *validation_says(validation),
        ]
    )
    report(result | learned, human, as_json=as_json)


def _settings_for(diagnoser: str, asked: Train) -> dict[str, Any]:
    """The settings of the diagnoser; in a process that may load an FMU, that for a model, too."""
    settings = asked.settings
    name = settings.get("model")
    if diagnoser != MODEL_BASED or name is None or not (is_inside() and names_fmu(name)):
        return settings
    # loads what compiles, for FMUs alone
    from residuum.identification.physics.fmu.watched_model import watched_model  # noqa: PLC0415

    return settings | {"model": watched_model(named(name))}


@dataclass(frozen=True)
class _Lessons:
    """What is learned from: records, a label each or None where all are healthy, and the exemplar
    that each comes from where that is known.
    """

    records: Sequence[Record]
    labels: Sequence[str] | None
    exemplars: Sequence[str] | None

    @property
    def truth(self) -> Sequence[str]:
        """A label a record."""
        return self.labels or ["healthy"] * len(self.records)

    @property
    def objects(self) -> Sequence[str]:
        """What is left out of the training together: exemplars, else records."""
        return self.exemplars or [str(k) for k in range(len(self.records))]

    def teach(self, judge: Diagnoser, indices: Sequence[int]) -> Diagnoser:
        """The diagnoser, fitted to these records."""
        chosen = [self.records[k] for k in indices]
        labels = None if self.labels is None else [self.labels[k] for k in indices]
        # It alone draws its limits so that they hold for a specimen that it has not seen.
        if isinstance(judge, GateActuator) and self.exemplars is not None:
            return judge.fit(chosen, labels, [self.exemplars[k] for k in indices])
        return judge.fit(chosen, labels)
