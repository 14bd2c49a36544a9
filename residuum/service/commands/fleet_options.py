"""What `rescore` and `reidentify` share: where the records are, the results file, the workers, and
the report.
"""

import os
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from residuum.identification.errors import BadInput
from residuum.service.commands.output_file import check_output_file
from residuum.service.commands.report import progress, report
from residuum.service.fleet.fleet import FleetSource, Work, answers_of, open_executor, run_fleet

Source = Annotated[
    str,
    typer.Argument(
        metavar="FOLDER|URL",
        help=(
            "Record files in a folder or a bucket (s3://…, file://…), a service's database"
            " (sqlite:///…), or windows of a history (timescale://host/database/table?window=600)."
        ),
    ),
]
Data = Annotated[
    Path | None, typer.Option(help="Data folder of the service, for the signals of its database.")
]
Results = Annotated[
    Path,
    typer.Option(
        "--out", help="Write one JSON line per record. An existing unfinished file is resumed."
    ),
]
Workers = Annotated[
    int | None, typer.Option(min=1, max=256, help="Worker processes (default: one a processor).")
]
Scheduler = Annotated[
    str | None,
    typer.Option(metavar="tcp://…", help="Dask scheduler whose workers see the same files."),
]

# How often a run tells how far it is: every per cent. Of a million records a line each would be the
# output.
_STEPS = 100


class FleetRun(NamedTuple):
    """Where a run over a fleet writes its results, who works, and how it reports."""

    results: Path
    workers: int | None
    scheduler: str | None
    as_json: bool


def run_over_fleet(source: FleetSource, work: Work, run: FleetRun, counts: dict[str, str]) -> None:
    """Do the work for every record of a fleet and report how many; `counts` maps a name to a dotted
    place and value.
    """
    check_output_file(run.results)
    files = source.items()
    # The results may stand in the folder of the records, and are none.
    if str(run.results) in files:
        files = [item for item in files if item != str(run.results)]
    if not files:
        raise BadInput(f"{source}: holds no record")
    workers = run.workers or os.cpu_count() or 1
    steps_told = 0

    def tell(done: int, all_files: int) -> None:
        nonlocal steps_told
        if done * _STEPS // all_files > steps_told:
            steps_told = done * _STEPS // all_files
            progress(f"{done} of {all_files} files")

    with open_executor(workers, run.scheduler) as executor:
        gone = run_fleet(files, work, executor, run.results, workers=workers, tell=tell)
    if gone:
        progress(f"{run.results}: {gone} results of other records were left out")
    summary = dict.fromkeys(("files", "refused", *counts), 0)
    for answer in answers_of(run.results):
        summary["files"] += 1
        summary["refused"] += "refused" in answer
        for name, place in counts.items():
            summary[name] += _at(answer, *place.split("="))
    says = ", ".join(f"{count} {name}" for name, count in summary.items())
    answer = summary | {"results": str(run.results)}
    report(answer, f"{says}; written to {run.results}", as_json=run.as_json)


def _at(result: dict[str, Any], place: str, wanted: str = "") -> bool:
    value: Any = result
    for name in place.split("."):
        value = value.get(name) if isinstance(value, dict) else None
    return value is not None and (not wanted or value == wanted)
