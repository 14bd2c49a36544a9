"""`residuum residual design` and `residuum residual run`: a detector from an identified model, and
what it says of a record.
"""

from pathlib import Path
from typing import Annotated, Any

import typer

from residuum.diagnosis.learning.stored import stored_kind
from residuum.diagnosis.residuals.multivariable import (
    KIND,
    MultivariableResidual,
    design_multivariable_residual,
)
from residuum.diagnosis.residuals.multivariable_detection import detect_multivariable
from residuum.diagnosis.residuals.residual_design import ResidualDesign
from residuum.identification.errors import BadInput
from residuum.identification.kernel_based.multivariable import is_multivariable, load_multivariable
from residuum.identification.linear_models.identified_model_file import load_identified
from residuum.identification.record import Record
from residuum.library.answers import multivariable_residual as several
from residuum.library.answers.residual import design_json, design_text
from residuum.library.questions.residual import DesignResidual, RunResidual, residual_for
from residuum.library.residual import judged
from residuum.service.commands.asked import asks
from residuum.service.commands.output_file import check_output_file
from residuum.service.commands.records import ChannelMap, Reading, reads
from residuum.service.commands.report import AsJson, progress, report

app = typer.Typer(add_completion=False)


@app.command()
@asks()
def design(
    identified: Annotated[
        Path, typer.Argument(help="Model file, as `residuum identify` writes it.")
    ],
    out: Annotated[Path, typer.Option(help="File for the design.")],
    asked: DesignResidual,
    healthy: Annotated[
        list[Path] | None,
        typer.Option(
            "--healthy", metavar="RECORD", help="Healthy records; default: those of the model."
        ),
    ] = None,
    channel_map: ChannelMap = None,
    as_json: AsJson = False,
) -> None:
    """Design a robust residual generator from an identified model."""
    check_output_file(out)
    if is_multivariable(identified):
        answer = _design_several(identified, out, asked, healthy or [], channel_map)
        return report(answer, several.design_text(answer), as_json=as_json)
    model = load_identified(identified)
    records = (
        Reading(channel_map).named(healthy)
        if healthy
        else _own_records(model.provenance.get("records", ()))
    )
    designed = residual_for(model, records, asked)
    designed.save(out)
    answer = design_json(designed, records, identified=str(identified), file=str(out))
    report(answer, design_text(designed, str(out)), as_json=as_json)


def _design_several(
    identified: Path,
    out: Path,
    asked: DesignResidual,
    healthy: list[Path],
    channel_map: list[str] | None,
) -> dict[str, Any]:
    model = load_multivariable(identified)
    own = model.models[0][0].provenance.get("records", ())
    records = Reading(channel_map).named(healthy) if healthy else _own_records(own)
    designed = design_multivariable_residual(
        model, records, method=asked.method, unknown=asked.unknown_input or []
    )
    designed.save(out)
    return several.design_json(designed, identified=str(identified), file=str(out))


def _own_records(names: Any) -> list[Record]:
    """The records a model was identified from, where they are still readable."""
    files = [Path(name) for name in names if isinstance(name, str) and name]
    # All or none: noise that is learned from some of a model's records would be told as that of
    # all.
    if not files or not all(file.is_file() for file in files):
        progress(
            "no healthy record at hand: noise as the model says, no `calibrated` threshold (give"
            " one with --healthy)"
        )
        return []
    return Reading().named(files)


@app.command()
@asks()
@reads()
def run(
    design: Annotated[
        Path, typer.Argument(help="Design file, as `residuum residual design` writes it.")
    ],
    record: Annotated[Path, typer.Argument(metavar="RECORD", help="Record file.")],
    asked: RunResidual,
    reading: Reading,
    as_json: AsJson = False,
) -> None:
    """Run a residual design on a record: is there a fault, since when, of which kind and size?"""
    loaded = reading.named([record])[0]
    # The design's file says which of both it is; the command need not be told.
    if stored_kind(design) == KIND:
        _only_posterior(asked)
        joint = detect_multivariable(
            MultivariableResidual.load(design),
            loaded,
            false_alarms_per_day=asked.false_alarms_per_day,
        )
        answer = several.run_json(loaded, joint, asked.false_alarms_per_day)
        return report(answer, several.run_text(answer), as_json=as_json)
    outcome = judged(ResidualDesign.load(design), loaded, asked)
    report(outcome.to_dict(), str(outcome), as_json=as_json)


def _only_posterior(asked: RunResidual) -> None:
    """Refuse what a design with several inputs or outputs does not have."""
    for name in ("threshold", "evaluation", "noise_bound"):
        if (value := getattr(asked, name)) != getattr(RunResidual(), name):
            rule = (
                "is not for a design with several inputs or outputs: it has the threshold posterior"
                " alone; leave it out"
            )
            raise BadInput(repr(value), name, rule)
