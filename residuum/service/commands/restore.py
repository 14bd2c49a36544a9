"""`residuum restore`: a backup into an empty data folder and database."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from residuum.identification.errors import BadInput
from residuum.service.commands.backup import described, in_words
from residuum.service.commands.report import AsJson, report
from residuum.service.commands.settings_template import DatabaseUrl
from residuum.service.settings import load_settings
from residuum.service.storage.backup import restore_backup
from residuum.service.storage.database import Database
from residuum.service.store import StorageUnavailable

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def restore(
    file: Annotated[Path, typer.Argument(help="A backup, from either kind of database.")],
    data: Annotated[
        Path | None, typer.Option(help="Folder for signal blocks and the default database.")
    ] = None,
    database: DatabaseUrl = None,
    as_json: AsJson = False,
) -> None:
    """Verify a backup and restore all of it, or nothing. Existing data are never changed.

    Files of settings come into the folder `settings-of-backup` of the data folder, for you to put
    in place.
    """
    settings = load_settings(data=data, database=database)
    rows = Database(settings.database_url)
    try:
        contents = restore_backup(file, rows, settings.data / "blocks")
    except (OSError, StorageUnavailable) as error:
        raise BadInput(f"{settings.data}: cannot be written: {error}") from None
    finally:
        rows.close()
    report(
        described(contents), f"Verified and restored: {file}\n{in_words(contents)}", as_json=as_json
    )
