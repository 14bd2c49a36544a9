"""`residuum reidentify`: a linear model of every record of a fleet."""

import typer

from residuum.identification.errors import BadInput
from residuum.library.questions.identify import Identify
from residuum.service.commands.asked import asks
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
from residuum.service.fleet.fleet import Reidentify, fleet_source

app = typer.Typer(add_completion=False)


@app.command()
# A line of the results holds the model alone; weight and tests are asked of one model, by
# `identify`.
@asks(without=("uncertainty", "check"))
def reidentify(
    records: Source,
    asked: Identify,
    out: Results,
    data: Data = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    as_json: AsJson = False,
) -> None:
    """Identify a model of every record of a folder, bucket or database, on all processors or a Dask
    cluster.

    An interrupted run can be resumed.
    """
    if asked.is_multivariable:
        raise BadInput("reidentify: takes one input and one output")
    source = fleet_source(records, data)
    run = FleetRun(out, workers, scheduler, as_json)
    run_over_fleet(source, Reidentify(asked, source), run, counts={"identified": "model.method"})
