"""`residuum score`: what a diagnoser says of records."""

from pathlib import Path
from typing import Any

import typer

from residuum.diagnosis.diagnosers import diagnoser_class
from residuum.diagnosis.diagnosers.base import Diagnoser
from residuum.diagnosis.finding import Verdict
from residuum.identification.errors import BadInput
from residuum.library.answers.finding import finding_text
from residuum.library.finding import Finding
from residuum.service.cli import ANSWER_IS_NO
from residuum.service.commands.diagnoser_options import (
    Baseline,
    DiagnoserName,
    FalseAlarms,
    Hertz,
    Method,
    Orders,
    SpeedRpm,
    diagnoser_settings,
    model_settings,
    new_diagnoser,
)
from residuum.service.commands.plot_option import Plot, check_plot, drawn
from residuum.service.commands.records import Reading, RecordFiles, reads
from residuum.service.commands.report import AsJson, report

app = typer.Typer(add_completion=False)
_WORST_FIRST = (Verdict.FAULTY, Verdict.NOT_ASSESSABLE, Verdict.HEALTHY)


@app.command()
@reads()
def score(
    diagnoser: DiagnoserName,
    records: RecordFiles,
    reading: Reading,
    baseline: Baseline = None,
    speed_rpm: SpeedRpm = None,
    orders: Orders = None,
    hertz: Hertz = None,
    method: Method = None,
    false_alarms_per_day: FalseAlarms = None,
    plot: Plot = None,
    as_json: AsJson = False,
) -> None:
    """Score records; exit status 1 when a window is faulty.

    One record gives its finding; several give the worst one and all of them under `findings`.
    """
    settings = diagnoser_settings(speed_rpm, orders, hertz, method) | model_settings(
        None, False, false_alarms_per_day
    )
    check_plot(plot)
    judge = _judge(diagnoser, baseline, settings)
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
        raise typer.Exit(ANSWER_IS_NO)


def _judge(name: str, baseline: Path | None, settings: dict[str, Any]) -> Diagnoser:
    if baseline is None:
        return new_diagnoser(name, settings)
    if not baseline.is_file():
        raise BadInput(f"{baseline}: no such baseline file")
    judge = diagnoser_class(name).load(baseline)
    return judge.with_settings(**settings) if settings else judge
