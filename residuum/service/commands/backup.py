"""`residuum backup`: database and signal blocks in one file, verified after it was written."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from residuum.identification.errors import BadInput
from residuum.service.commands.report import AsJson, report
from residuum.service.settings import load_settings
from residuum.service.storage.backup import write_backup
from residuum.service.storage.backup_contents import Contents
from residuum.service.storage.database import Database, sqlite_file
from residuum.service.store import StorageUnavailable

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def backup(
    file: Annotated[Path, typer.Argument(help="The backup to write; it must not be there yet.")],
    data: Annotated[Path | None, typer.Option(help="Folder of signal blocks and the default database.")] = None,
    database: Annotated[str | None, typer.Option(help="SQLAlchemy URL; default: SQLite in the data folder.")] = None,
    as_json: AsJson = False,
) -> None:
    """Back up rows and signals as they are at this moment. Settings and the file of API keys are not part of it."""
    settings = load_settings(data=data, database=database)
    source = sqlite_file(settings.database_url)
    if source is not None and not source.is_file():
        raise BadInput(f"database {source}: is not there; nothing to back up")
    rows = Database(settings.database_url)
    try:
        contents = write_backup(rows, settings.data / "blocks", file)
    except (OSError, StorageUnavailable) as error:
        raise BadInput(f"{file}: cannot be written: {error}") from None
    finally:
        rows.close()
    report(described(contents), f"Written and verified: {file}\n{in_words(contents)}", as_json=as_json)


def described(contents: Contents) -> dict[str, Any]:
    """What a backup holds, for --json."""
    return {
        "created_at": contents.created_at,
        "revision": contents.revision,
        "rows": dict(contents.rows),
        "blocks": contents.blocks,
        "size_bytes": contents.size_bytes,
    }


def in_words(contents: Contents) -> str:
    """What a backup holds, for people."""
    rows = ", ".join(f"{count} {table.replace('_', ' ')}" for table, count in contents.rows.items())
    size = f"{contents.blocks} signal blocks of {contents.size_bytes / 2**20:.1f} MiB"
    return f"{rows}; {size}; from {contents.created_at:%Y-%m-%d %H:%M:%S} UTC"
