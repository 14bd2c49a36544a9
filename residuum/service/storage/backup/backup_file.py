"""Backup: rows and signal blocks in one tar file, the same whichever database they came from, verified before it gets its name.

Members, in this order: `begin.json` with the schema's revision; `settings/NAME`, the files of the settings;
`blocks/DAY/NAME.block` as they are on disk; `rows/TABLE.jsonl`, a row a line, tables before those that point to them; `end.json`
with every table's number of rows and SHA-256, and the SHA-256 of every file of the settings. A file that was cut off has no end
and is refused.
"""

from __future__ import annotations

import hashlib
import io
import os
import tarfile
import tempfile
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any

import orjson
from sqlalchemy import Connection, Table

from residuum.service.storage.backup.backup_contents import BEGIN, END, FORMAT, BackupReader, BadBackup, Contents
from residuum.service.storage.blocks import BlockReference
from residuum.service.storage.database import Database, newest_revision
from residuum.service.storage.durable_folder import sync_folder
from residuum.service.storage.rows import block_rows, plain_rows


def write_backup(database: Database, blocks: Path, file: Path, settings: Mapping[str, bytes] = MappingProxyType({})) -> Contents:
    """Back up a running or a stopped service, with the files of its settings by name.

    Returns what the file holds, after it has been read back and verified.

    Rows are those of one moment. A signal that the retention rule removes meanwhile is marked as let go in the backup.
    Raises BadBackup when `file` exists, a block is missing or differs from its checksum, or the schema is not up to date; OSError
    when the file cannot be written.
    """
    if file.exists():
        raise BadBackup(f"{file}: is there already; a backup never replaces a file")
    if database.revision() != newest_revision():
        raise BadBackup(
            f"database: its schema is at revision {database.revision()}; a start of the service brings it to {newest_revision()}"
        )
    unfinished = file.with_name(f"{file.name}.unfinished")
    unfinished.unlink(missing_ok=True)  # what lies there keeps its own mode
    try:
        with open(os.open(unfinished, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as raw:
            with database.snapshot() as connection, tarfile.open(fileobj=raw, mode="w", format=tarfile.PAX_FORMAT) as archive:
                _write_members(archive, database, connection, blocks, settings)
            raw.flush()
            os.fsync(raw.fileno())
        contents = BackupReader().read(unfinished)
        os.replace(unfinished, file)
    except BaseException:
        unfinished.unlink(missing_ok=True)
        raise
    sync_folder(file.parent)
    return contents


def _write_members(
    archive: tarfile.TarFile, database: Database, connection: Connection, blocks: Path, settings: Mapping[str, bytes]
) -> None:
    _add_json(archive, BEGIN, {"format": FORMAT, "created_at": datetime.now(UTC), "revision": database.revision()})
    for name, content in settings.items():
        archive.addfile(_member(f"settings/{name}", len(content)), io.BytesIO(content))
    gone = {block.path for block in block_rows.references(connection) if not _add_block(archive, blocks, block)}
    _refuse_lost(database, gone)
    described = {}
    for table in plain_rows.tables_of(connection):
        found = plain_rows.lines(connection, table)
        marked = _let_go(found, gone) if gone and table.name == "windows" else found
        described[str(table.name)] = _add_rows(archive, table, marked)
    digests = {name: hashlib.sha256(content).hexdigest() for name, content in settings.items()}
    _add_json(archive, END, {"rows": described, "settings": digests})


def _add_block(archive: tarfile.TarFile, blocks: Path, block: BlockReference) -> bool:
    try:
        with open(blocks / block.path, "rb") as stream:
            archive.addfile(_member(f"blocks/{block.path}", os.fstat(stream.fileno()).st_size), stream)
    except FileNotFoundError:
        return False
    return True


def _refuse_lost(database: Database, gone: set[str]) -> None:
    """BadBackup when a block has gone that a row still points to."""
    if not gone:
        return
    with database.read() as connection:
        lost = sorted(gone & {block.path for block in block_rows.references(connection)})
    if lost:
        raise BadBackup(f"signal block {lost[0]}: is missing ({len(lost)} in all); nothing was backed up")


def _let_go(found: Iterator[bytes], gone: set[str]) -> Iterator[bytes]:
    now = datetime.now(UTC).replace(tzinfo=None)
    for line in found:
        row = orjson.loads(line)
        yield orjson.dumps(row | {"signal_let_go_at": now}) + b"\n" if row["block_path"] in gone else line


def _add_rows(archive: tarfile.TarFile, table: Table, found: Iterator[bytes]) -> dict[str, Any]:
    digest, count = hashlib.sha256(), 0
    with tempfile.TemporaryFile() as spooled:
        for line in found:
            spooled.write(line)
            digest.update(line)
            count += 1
        size = spooled.tell()
        spooled.seek(0)
        archive.addfile(_member(f"rows/{table.name}.jsonl", size), spooled)
    return {"count": count, "sha256": digest.hexdigest()}


def _add_json(archive: tarfile.TarFile, name: str, content: Any) -> None:
    text = orjson.dumps(content)
    archive.addfile(_member(name, len(text)), io.BytesIO(text))


def _member(name: str, size: int) -> tarfile.TarInfo:
    member = tarfile.TarInfo(name)
    member.size = size
    member.mode = 0o600
    return member
