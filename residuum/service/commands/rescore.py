"""`residuum rescore`: a diagnoser's finding on every record of a fleet."""

from typing import Annotated

import typer

from residuum.diagnosis.diagnosers import DIAGNOSERS, diagnoser_class
from residuum.identification.errors import BadInput
from residuum.service.commands.fleet_options import (
    Data,
    FleetRun,
    Results,
    Scheduler,
    Source,
    Workers,
    run_over_fleet,
)
from residuum.service.commands.report import AsJson
from residuum.service.commands.score import Baseline
from residuum.service.fleet.fleet import Rescore, StoredWindows, fleet_source
from residuum.service.fleet.own_judges import OWN, rescore_own

app = typer.Typer(add_completion=False)

_VERDICTS = {
    verdict: f"finding.verdict={verdict}" for verdict in ("healthy", "faulty", "not-assessable")
}


@app.command()
def rescore(
    diagnoser: Annotated[
        str,
        typer.Argument(
            metavar="DIAGNOSER|own",
            help=(
                f"One of {', '.join(DIAGNOSERS)}; of a database also own: each machine's own"
                " diagnoser, baseline and method."
            ),
        ),
    ],
    records: Source,
    out: Results,
    baseline: Baseline = None,
    data: Data = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    as_json: AsJson = False,
) -> None:
    """Score every record of a folder, bucket or database, on all processors or a Dask cluster.

    An interrupted run can be resumed.
    """
    run = FleetRun(out, workers, scheduler, as_json)
    if diagnoser == OWN:
        if baseline is not None:
            raise BadInput("--baseline: each has its own; leave it out")
        source = fleet_source(records, data)
        if not isinstance(source, StoredWindows):
            raise BadInput(
                f"{records}: is no database; files and buckets have no diagnoser of their own,"
                " name one"
            )
        source.items()  # refused here where the database is none of this version
        run_over_fleet(source, rescore_own(source), run, counts=_VERDICTS)
        return
    if baseline is not None:
        if not baseline.is_file():
            raise BadInput(f"{baseline}: no such baseline file")
        diagnoser_class(diagnoser).load(baseline)  # refused here, once, rather than for every file
    else:
        diagnoser_class(diagnoser)
    source = fleet_source(records, data)
    # The whole path: workers may run in another folder than the command.
    work = Rescore(diagnoser, None if baseline is None else str(baseline.resolve()), source)
    run_over_fleet(source, work, run, counts=_VERDICTS)
