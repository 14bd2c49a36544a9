"""`residuum backup`: database and signal blocks in one file, verified after it was written."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Annotated, Any

import orjson
import typer

from residuum.identification.errors import BadInput
from residuum.service.commands.report import AsJson, report
from residuum.service.commands.settings_template import DatabaseUrl, SettingsFile
from residuum.service.settings import SETTINGS_FILE, Settings, load_settings
from residuum.service.storage.backup import Contents, write_backup
from residuum.service.storage.database import Database, sqlite_file
from residuum.service.store import StorageUnavailable

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def backup(
    file: Annotated[Path, typer.Argument(help="Backup file to write; it must not exist yet.")],
    data: Annotated[
        Path | None, typer.Option(help="Folder of signal blocks and the default database.")
    ] = None,
    database: DatabaseUrl = None,
    settings_file: SettingsFile = None,
    as_json: AsJson = False,
) -> None:
    """Back up rows, signals, and the settings' file with the maps and models that it names, as they
    are at this moment.

    The settings may hold passwords: the backup is readable by its owner alone. Not part of it:
    environment variables, the file of API keys, certificates.
    """
    settings = load_settings(settings_file, data=data, database=database)
    source = sqlite_file(settings.database_url)
    # SQLite would make an empty one, whose backup would be whole and hold nothing.
    if source is not None and not source.is_file():
        raise BadInput(f"database {source}: is not there; nothing to back up")
    rows = Database(settings.database_url)
    try:
        contents = write_backup(rows, settings.data / "blocks", file, _files_of(settings))
    except (OSError, StorageUnavailable) as error:
        raise BadInput(f"{file}: cannot be written: {error}") from None
    finally:
        rows.close()
    report(
        described(contents), f"Written and verified: {file}\n{in_words(contents)}", as_json=as_json
    )


def _files_of(settings: Settings) -> dict[str, bytes]:
    """The settings' file and the files that it names, each under a name of its own; `places.json`
    says where they were.
    """
    named = os.environ.get(SETTINGS_FILE)
    if named is None:
        return {}
    # The settings name maps and models by path: without them a restored service could not read its
    # machines.
    wanted = [Path(named)]
    for machine in settings.machines:
        wanted += [source.map_file for source in machine.sources]
        wanted += [
            Path(model)
            for model in (machine.model, machine.second and machine.second.model)
            if model
        ]
    # Numbered: two files of one name from two folders must not replace each other. A file that
    # several machines name is kept once.
    places = {
        f"{number:03}-{_plain(place.name)}": place
        for number, place in enumerate(dict.fromkeys(wanted))
        if place.is_file()
    }
    listing = orjson.dumps(
        {name: str(place.resolve()) for name, place in places.items()}, option=orjson.OPT_INDENT_2
    )
    return {name: place.read_bytes() for name, place in places.items()} | {"places.json": listing}


def _plain(name: str) -> str:
    # The names that a restore lets pass, cut so that with the number they stay within its 200
    # characters.
    return re.sub(r"[^A-Za-z0-9._-]", "_", name)[:150]


def described(contents: Contents) -> dict[str, Any]:
    """What a backup holds, for --json."""
    return {
        "created_at": contents.created_at,
        "revision": contents.revision,
        "rows": dict(contents.rows),
        "blocks": contents.blocks,
        "size_bytes": contents.size_bytes,
        "settings": list(contents.settings),
    }


def in_words(contents: Contents) -> str:
    """What a backup holds, for people."""
    rows = ", ".join(f"{count} {table.replace('_', ' ')}" for table, count in contents.rows.items())
    size = f"{contents.blocks} signal blocks of {contents.size_bytes / 2**20:.1f} MiB"
    files = f"{len(contents.settings)} files of settings" if contents.settings else "no settings"
    return f"{rows}; {size}; {files}; from {contents.created_at:%Y-%m-%d %H:%M:%S} UTC"
