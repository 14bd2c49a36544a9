"""`residuum reidentify`: a linear model of every record of a fleet."""

from typing import Annotated

import typer

from residuum.identification.errors import BadInput
from residuum.library.identification_methods import METHODS, Request
from residuum.nearest_names import known_names
from residuum.service.commands.fleet_options import Data, Results, Scheduler, Source, Workers, run_over_fleet
from residuum.service.commands.report import AsJson
from residuum.service.work.fleet_source import fleet_source
from residuum.service.work.fleet_work import Reidentify

app = typer.Typer(add_completion=False)


@app.command()
def reidentify(
    records: Source,
    input: Annotated[str, typer.Option("--input", metavar="CH", help="Channel of the input.")],
    output: Annotated[str, typer.Option("--output", metavar="CH", help="Channel of the output.")],
    out: Results,
    method: Annotated[str, typer.Option(help=f"One of {', '.join(METHODS)}.")] = "kernel",
    kernel: Annotated[str, typer.Option(help="Prior of the impulse response: tc, dc, ss or di.")] = "tc",
    order: Annotated[int | None, typer.Option(min=1, help="Impulse-response length (kernel: 100) or model order.")] = None,
    delay: Annotated[int, typer.Option(min=0, help="Samples before the input acts.")] = 1,
    data: Data = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    as_json: AsJson = False,
) -> None:
    """Identify a model of every record of a folder, bucket or database, on all processors or a Dask cluster.

    An interrupted run can be resumed.
    """
    if method not in METHODS:
        raise BadInput(f"--method {method!r}: there is none of this name; {known_names(method, METHODS)}")
    source = fleet_source(records, data)
    work = Reidentify(method, Request(input, output, order, delay, kernel, "marginal", True), source)
    run_over_fleet(
        source, work, out, workers=workers, scheduler=scheduler, as_json=as_json, counts={"identified": "model.method"}
    )
