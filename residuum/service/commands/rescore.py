"""`residuum rescore`: a diagnoser's finding on every record of a fleet."""

from dataclasses import replace
from pathlib import Path
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
from residuum.service.fleet.fleet import (
    FleetSource,
    HistoryWindows,
    Rescore,
    StoredWindows,
    fleet_source,
    machines_in,
)
from residuum.service.fleet.own_judges import OWN, rescore_own
from residuum.service.machines.scoring import diagnoser_of_file
from residuum.service.settings import load_settings

app = typer.Typer(add_completion=False)

Baselines = Annotated[
    Path | None,
    typer.Option(
        help=(
            "A trained diagnoser, as `train` writes it; or a folder with MACHINE.baseline for each"
            " machine of a history that is judged."
        )
    ),
]
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
    baseline: Baselines = None,
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
        own = rescore_own(source, fmus=load_settings(data=data).allow_fmus)
        run_over_fleet(source, own, run, counts=_VERDICTS)
        return
    diagnoser_class(diagnoser)
    source = fleet_source(records, data)
    if baseline is not None and baseline.is_dir():
        source = _of_machines(source, baseline)
    # The whole path: workers may run in another folder than the command.
    work = Rescore(diagnoser, None if baseline is None else str(baseline.resolve()), source)
    for file in work.baselines:
        if not Path(file).is_file():
            raise BadInput(f"{file}: no such baseline file")
        # refused here, once, rather than for every record; an FMU in it is loaded by workers alone
        diagnoser_of_file(diagnoser, file, fmus=True)
    run_over_fleet(source, work, run, counts=_VERDICTS)


def _of_machines(source: FleetSource, folder: Path) -> HistoryWindows:
    """The windows of those machines of a history that have a baseline in the folder."""
    if not isinstance(source, HistoryWindows) or not source.each:
        raise BadInput(
            f"--baseline {folder}: is a folder; only windows of a history tell whose they are, by"
            " &each=COLUMN; name a file"
        )
    machines = machines_in(folder)
    if not machines:
        raise BadInput(
            f"--baseline {folder}: holds no MACHINE.baseline; write each with `residuum train … --out"
            f" {folder}/MACHINE.baseline`"
        )
    return replace(source, machines=machines)
