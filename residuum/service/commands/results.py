"""`residuum results`: findings and windows as Parquet files, a machine's month as a page."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from residuum.identification.errors import BadInput
from residuum.service.commands.output_file import check_output_file
from residuum.service.commands.report import AsJson
from residuum.service.commands.report import report as tell
from residuum.service.commands.settings_template import SettingsFile
from residuum.service.results.month_report import month_report
from residuum.service.results.parquet_tables import span_of, write_findings, write_windows
from residuum.service.results.report_page import report_page
from residuum.service.settings import load_settings
from residuum.service.storage import DiskStore
from residuum.service.storage.database import Database, sqlite_file

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)

AssetArgument = Annotated[str, typer.Argument(metavar="MACHINE", help="Name of the machine.")]
Data = Annotated[
    Path | None, typer.Option(help="Folder of signal blocks and the default database.")
]
DatabaseUrl = Annotated[
    str | None, typer.Option(help="SQLAlchemy URL; default: SQLite in the data folder.")
]


@app.command()
def parquet(
    asset: AssetArgument,
    begin: Annotated[
        str,
        typer.Option(
            "--from",
            help=(
                "Begin, for example 2026-11-01 or 2026-11-01T08:00+01:00. Without a zone it is UTC."
            ),
        ),
    ],
    end: Annotated[
        str, typer.Option("--to", help="End of the span. What begins there is not part of it.")
    ],
    out: Annotated[
        Path, typer.Option(help="Folder for MACHINE-findings.parquet and MACHINE-windows.parquet.")
    ],
    windows: Annotated[
        bool, typer.Option(help="Write the windows with their signals, too.")
    ] = True,
    data: Data = None,
    database: DatabaseUrl = None,
    settings_file: SettingsFile = None,
    as_json: AsJson = False,
) -> None:
    """Write a machine's findings and windows of a span of time as Parquet files. The service may be
    running.
    """
    span = span_of(begin, end)
    with _store(settings_file, data, database) as store:
        # A mistyped machine is refused before a folder is made for it.
        store.asset(asset)
        out.mkdir(parents=True, exist_ok=True)
        files = {
            "findings": out / f"{asset}-findings.parquet",
            "windows": out / f"{asset}-windows.parquet",
        }
        rows = {"findings": write_findings(store, asset, span, files["findings"])}
        if windows:
            rows["windows"] = write_windows(store, asset, span, files["windows"])
    written = {name: {"file": str(files[name]), "rows": number} for name, number in rows.items()}
    tell(
        written,
        "\n".join(f"{entry['file']}: {entry['rows']} rows" for entry in written.values()),
        as_json=as_json,
    )


@app.command("report")
def month(
    asset: AssetArgument,
    of_month: Annotated[str, typer.Option("--month", help="YYYY-MM, in UTC.")],
    out: Annotated[Path, typer.Option(help="The HTML file to write.")],
    data: Data = None,
    database: DatabaseUrl = None,
    settings_file: SettingsFile = None,
    as_json: AsJson = False,
) -> None:
    """Write what happened at a machine in a month, as one page that opens offline."""
    check_output_file(out)
    with _store(settings_file, data, database) as store:
        report = month_report(store, asset, of_month)
    out.write_text(report_page(report), encoding="utf-8")
    verdicts = dict(report.verdicts)
    says = ", ".join(f"{number} {name}" for name, number in verdicts.items()) or "no window"
    tell(
        {"file": str(out), "windows": verdicts, "faults": list(report.faults)},
        f"{out}: {says}",
        as_json=as_json,
    )


@contextmanager
def _store(
    settings_file: Path | None, data: Path | None, database: str | None
) -> Iterator[DiskStore]:
    settings = load_settings(settings_file, data=data, database=database)
    source = sqlite_file(settings.database_url)
    if source is not None and not source.is_file():
        raise BadInput(f"database {source}: is not there; nothing was stored yet")
    # Looked at before a store is opened, which would migrate the schema: a service of another
    # version may be running on it.
    existing = Database(settings.database_url)
    try:
        existing.refuse_other_revision()
    finally:
        existing.close()
    store = DiskStore(settings.data, settings.database_url)
    try:
        yield store
    finally:
        store.close()
