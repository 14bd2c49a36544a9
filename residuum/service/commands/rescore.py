"""`residuum rescore`: a diagnoser's finding on every record of a fleet."""

from pathlib import Path
from typing import Annotated

import typer

from residuum.identification.errors import BadInput
from residuum.service.commands.diagnoser_options import DiagnoserName, diagnoser_class
from residuum.service.commands.fleet_options import Data, Results, Scheduler, Source, Workers, run_over_fleet
from residuum.service.commands.report import AsJson
from residuum.service.work.fleet_source import fleet_source
from residuum.service.work.fleet_work import Rescore

app = typer.Typer(add_completion=False)


@app.command()
def rescore(
    diagnoser: DiagnoserName,
    records: Source,
    out: Results,
    baseline: Annotated[Path | None, typer.Option(help="A trained diagnoser, as `train` writes it.")] = None,
    data: Data = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    as_json: AsJson = False,
) -> None:
    """Score every record of a folder, bucket or database, by all processors or a Dask cluster; can be gone on with."""
    if baseline is not None:
        if not baseline.is_file():
            raise BadInput(f"{baseline}: no such baseline file")
        diagnoser_class(diagnoser).load(baseline)  # refused here, once, rather than for every file
    else:
        diagnoser_class(diagnoser)
    source = fleet_source(records, data)
    work = Rescore(diagnoser, None if baseline is None else str(baseline.resolve()), source)
    verdicts = {verdict: f"finding.verdict={verdict}" for verdict in ("healthy", "faulty", "not-assessable")}
    run_over_fleet(source, work, out, workers=workers, scheduler=scheduler, as_json=as_json, counts=verdicts)
