"""Restore: the rows and signal blocks of a backup into an empty database and an empty folder, all of it or nothing."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from sqlalchemy import Connection, delete

from residuum.service.storage import identity
from residuum.service.storage.backup.backup_contents import BackupReader, BadBackup, Contents
from residuum.service.storage.database import Database, known_revisions, newest_revision
from residuum.service.storage.durable_folder import make_folder, sync_folder
from residuum.service.storage.rows import plain_rows

SETTINGS = "settings-of-backup"
"""Folder of the restored files of settings, beside that of the blocks."""


def restore_backup(file: Path, database: Database, blocks: Path) -> Contents:
    """Bring back what `write_backup` wrote, from either kind of database into either kind; returns what was restored.

    Files of settings come into `SETTINGS` beside the blocks' folder, for somebody to look at: what a service runs by is never
    replaced. The file is verified before anything is written. Rows get the backup's schema, which is then migrated to the newest.
    Raises BadBackup when the file is not a whole backup of this program's or an older schema, or the target is not empty.
    """
    contents = BackupReader().read(file)
    if contents.revision not in known_revisions():
        raise BadBackup(
            f"{file}: its schema, revision {contents.revision}, is none that this program knows; it knows {newest_revision()}"
        )
    if database.revision() is not None:
        raise BadBackup("database: is not empty; restore goes into a new one")
    if any(blocks.glob("*/*")):
        raise BadBackup(f"{blocks}: is not empty; restore goes into a new folder")
    beside = blocks.parent / SETTINGS
    if contents.settings and beside.exists():
        raise BadBackup(f"{beside}: is there already; the settings of the backup go into a new folder")
    database.migrate(contents.revision)
    written: list[Path] = []
    try:
        with database.write() as connection:
            _Restorer(connection, blocks, written).read(file)
        database.migrate()
        identity.forget(database)
    except BaseException:
        database.migrate("base")
        for block in written:
            block.unlink(missing_ok=True)
        if contents.settings:
            shutil.rmtree(beside, ignore_errors=True)
        raise
    return contents


class _Restorer(BackupReader):
    """Writes blocks and rows as they come."""

    def __init__(self, connection: Connection, blocks: Path, written: list[Path]) -> None:
        self._connection = connection
        self._tables = {table.name: table for table in plain_rows.tables_of(connection)}
        self._blocks = blocks
        self._written = written

    def take_block(self, path: str, pieces: Iterator[bytes]) -> None:
        """Write a block below the folder; its name has been matched against the pattern of ours."""
        file = self._blocks / path
        make_folder(file.parent)
        with open(file, "xb") as stream:
            self._written.append(file)
            stream.writelines(pieces)
            stream.flush()
            os.fsync(stream.fileno())

    def take_settings(self, name: str, content: bytes) -> None:
        """Write a file of the settings, for its owner alone: it may hold passwords."""
        folder = self._blocks.parent / SETTINGS
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        with open(os.open(folder / name, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as stream:
            stream.write(content)

    def take_rows(self, table: str, lines: Iterator[bytes]) -> None:
        """Insert a table's rows; the blocks they point to are on disk by now."""
        for folder in {self._blocks, *(file.parent for file in self._written)} if self._written else ():
            sync_folder(folder)
        self._connection.execute(delete(self._tables[table]))  # a migration may have begun a table with a row of its own
        plain_rows.insert_lines(self._connection, self._tables[table], lines)
