"""`residuum score`: what a diagnoser says of records."""

from pathlib import Path
from typing import Annotated

import typer

from residuum.diagnosis.diagnosers import DIAGNOSERS, diagnoser_class, untrained
from residuum.diagnosis.diagnosers.base import Diagnoser
from residuum.diagnosis.finding import Verdict
from residuum.identification.errors import BadInput
from residuum.identification.physics.fmu.permission import fmus_allowed
from residuum.library.answers.finding import finding_text
from residuum.library.finding import Finding
from residuum.library.questions.score import Score
from residuum.service.cli import ANSWER_IS_NO
from residuum.service.commands.asked import asks
from residuum.service.commands.fmu_process import is_inside
from residuum.service.commands.plot_option import Plot, check_plot, drawn
from residuum.service.commands.records import Reading, RecordFiles, reads
from residuum.service.commands.report import AsJson, report

DiagnoserName = Annotated[
    str, typer.Argument(metavar="DIAGNOSER", help=f"One of {', '.join(DIAGNOSERS)}.")
]
Baseline = Annotated[Path | None, typer.Option(help="A trained diagnoser, as `train` writes it.")]
app = typer.Typer(add_completion=False)
# Of several records the worst finding is the answer, and the exit status goes by it; one that
# cannot be judged stands before a healthy one, for a fault may be hidden in it.
_WORST_FIRST = (Verdict.FAULTY, Verdict.NOT_ASSESSABLE, Verdict.HEALTHY)


@app.command()
@asks()
@reads()
def score(
    diagnoser: DiagnoserName,
    records: RecordFiles,
    reading: Reading,
    asked: Score,
    baseline: Baseline = None,
    plot: Plot = None,
    as_json: AsJson = False,
) -> None:
    """Score records; exit status 1 when a window is faulty.

    One record gives its finding; several give the worst one and all of them under `findings`.
    """
    check_plot(plot)
    judge = _judge(diagnoser, baseline, asked)
    loaded = reading.named(records)
    judged = [judge.score(record) for record in loaded]
    findings = [
        finding.to_json() | {"record": str(file)}
        for file, finding in zip(records, judged, strict=True)
    ]
    worst = min(findings, key=lambda finding: _WORST_FIRST.index(finding["verdict"]))
    result = findings[0] if len(findings) == 1 else worst | {"findings": findings}
    result |= drawn(
        plot,
        [Finding(finding) for finding in judged],
        f"{diagnoser}: {', '.join(map(str, records))}",
    )
    report(result, "\n".join(finding_text(finding) for finding in findings), as_json=as_json)
    if worst["verdict"] == Verdict.FAULTY:
        # as every command whose question has yes and no for an answer
        raise typer.Exit(ANSWER_IS_NO)


def _judge(name: str, baseline: Path | None, asked: Score) -> Diagnoser:
    if baseline is None:
        return untrained(diagnoser_class(name), **asked.settings)
    if not baseline.is_file():
        raise BadInput(f"{baseline}: no such baseline file")
    # Settings that were given go over those that the baseline was trained with.
    with fmus_allowed(is_inside()):
        judge = diagnoser_class(name).load(baseline)
    return judge.with_settings(**asked.settings) if asked.settings else judge
