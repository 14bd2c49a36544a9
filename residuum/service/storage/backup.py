"""Backup and restore of everything that is stored."""

from __future__ import annotations

import base64
import hashlib
import io
import os
import re
import shutil
import tarfile
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from types import MappingProxyType
from typing import IO, Any

import orjson
from sqlalchemy import Connection, MetaData, Table, delete, func, insert, select

from residuum.identification.errors import BadInput
from residuum.service.storage import identity
from residuum.service.storage.blocks import BlockReference
from residuum.service.storage.database import Database, known_revisions, newest_revision
from residuum.service.storage.durable_folder import make_folder, sync_folder
from residuum.service.storage.rows import block_rows

# Rows of any schema revision as lines of JSON and back: the tables are read from the database, not
# from the code, for a backup may be of an older schema than the code's.

_VERSION_TABLE = "alembic_version"
# Rows that are inserted, or fetched, at once. Tables may be larger than the memory.
_AT_ONCE = 500


def _tables_of(connection: Connection) -> list[Table]:
    """The tables there are, those that others point to first; without the one that keeps the
    schema's revision.
    """
    metadata = MetaData()
    metadata.reflect(connection)
    return [table for table in metadata.sorted_tables if table.name != _VERSION_TABLE]


def _lines_of(connection: Connection, table: Table) -> Iterator[bytes]:
    """Every row as a line of JSON, in order of the primary key; bytes in Base64, moments as in ISO
    8601 (UTC).
    """
    query = select(table).order_by(*table.primary_key.columns)
    for row in connection.execute(query.execution_options(yield_per=_AT_ONCE)).mappings():
        yield orjson.dumps({str(name): _plain(value) for name, value in row.items()}) + b"\n"


def _insert_lines(connection: Connection, table: Table, row_lines: Iterable[bytes]) -> None:
    """Insert rows that `_lines_of` gave, and let the database count its numbers on from there."""
    kinds = {column.name: column.type.python_type for column in table.columns}
    batch = []
    for line in row_lines:
        batch.append(
            {name: _back(value, kinds[name]) for name, value in orjson.loads(line).items()}
        )
        # in batches: a table may be larger than the memory
        if len(batch) == _AT_ONCE:
            connection.execute(insert(table), batch)
            batch = []
    if batch:
        connection.execute(insert(table), batch)
    _count_on(connection, table)


def _plain(value: Any) -> Any:
    return base64.b64encode(value).decode() if isinstance(value, bytes | memoryview) else value


def _back(value: Any, kind: type) -> Any:
    if value is None:
        return None
    if kind is bytes:
        return base64.b64decode(value)
    return datetime.fromisoformat(value) if kind is datetime else value


def _count_on(connection: Connection, table: Table) -> None:
    """PostgreSQL numbers rows by a sequence of its own, which rows with given numbers do not
    move.
    """
    if connection.dialect.name != "postgresql" or table.autoincrement_column is None:
        return
    column = table.autoincrement_column
    sequence = connection.scalar(select(func.pg_get_serial_sequence(table.name, column.name)))
    highest = connection.scalar(select(func.max(column)))
    if sequence is not None and highest is not None:
        connection.execute(select(func.setval(sequence, highest)))


# What a backup file holds, read from its begin to its end and verified on the way.

FORMAT = "residuum-backup-1"
BEGIN, END = "begin.json", "end.json"
# Names of members become paths at a restore, and a backup may be anybody's file: only names of ours
# pass, so that none leads out of the folder.
_BLOCK = re.compile(r"blocks/([0-9]{4}-[0-9]{2}-[0-9]{2}/[0-9a-f]{32}\.block)")
_ROWS = re.compile(r"rows/([a-z_]{1,60})\.jsonl")
_SETTINGS = re.compile(r"settings/([A-Za-z0-9][A-Za-z0-9._-]{0,199})")
# Bytes of a block that are read at once.
_PIECE = 2**20


class BadBackup(BadInput):
    """The file is no backup, is not whole, or differs from its checksums; or there is something
    where it is to be restored.
    """


@dataclass(frozen=True)
class Contents:
    """What a verified backup holds."""

    created_at: datetime
    revision: str
    rows: Mapping[str, int]
    blocks: int
    size_bytes: int
    settings: Sequence[str] = ()
    """Names of the files of settings."""


class BackupReader:
    """Reads a backup once and verifies it; a subclass takes what it holds on the way, before the
    whole is known to be good.
    """

    def take_block(self, _path: str, pieces: Iterator[bytes]) -> None:
        """A signal block, piece by piece."""
        for _ in pieces:
            pass

    def take_rows(self, _table: str, lines: Iterator[bytes]) -> None:
        """The rows of a table, line by line; every table comes after those it points to."""
        for _ in lines:
            pass

    def take_settings(self, _name: str, _content: bytes) -> None:
        """A file of the settings."""

    def read(self, file: Path) -> Contents:
        """Read the whole file: every block against the checksum in its row, every table against the
        manifest.

        Raises BadBackup with one line that says what is wrong and where.
        """
        tally = _Tally()
        try:
            with tarfile.open(file, "r:") as archive:
                for member in archive:
                    stream = archive.extractfile(member) if member.isreg() else None
                    if stream is None:
                        raise BadBackup(f"{file}: member {member.name[:80]!r} is no plain file")
                    if member.name == END:
                        return tally.verified(file, orjson.loads(stream.read()))
                    self._take(file, member.name, stream, tally)
        except (tarfile.TarError, EOFError, OSError, ValueError, KeyError, TypeError) as error:
            raise BadBackup(f"{file}: is not a whole backup: {error}") from None
        raise BadBackup(f"{file}: is not a whole backup: its end is missing")

    def _take(self, file: Path, name: str, stream: IO[bytes], tally: _Tally) -> None:
        if match := _BLOCK.fullmatch(name):
            self.take_block(match[1], tally.block(match[1], stream))
        elif match := _ROWS.fullmatch(name):
            self.take_rows(match[1], tally.rows(match[1], stream))
        elif match := _SETTINGS.fullmatch(name):
            self.take_settings(match[1], tally.settings_file(match[1], stream))
        elif name == BEGIN:
            tally.begin(file, orjson.loads(stream.read()))
        else:
            raise BadBackup(f"{file}: member {name[:80]!r} does not belong into a backup")


@dataclass
class _Tally:
    """Checksums of what has come so far."""

    revision: str = ""
    created_at: str = ""
    blocks: dict[str, str] = field(default_factory=dict)
    referred: dict[str, str] = field(default_factory=dict)
    tables: dict[str, dict[str, Any]] = field(default_factory=dict)
    settings: dict[str, str] = field(default_factory=dict)
    size_bytes: int = 0

    def begin(self, file: Path, described: Mapping[str, Any]) -> None:
        if described["format"] != FORMAT:
            raise BadBackup(
                f"{file}: format {str(described['format'])[:40]!r}; this program reads {FORMAT}"
            )
        self.revision, self.created_at = str(described["revision"]), str(described["created_at"])

    def block(self, path: str, stream: IO[bytes]) -> Iterator[bytes]:
        digest = hashlib.sha256()
        while piece := stream.read(_PIECE):
            digest.update(piece)
            self.size_bytes += len(piece)
            yield piece
        self.blocks[path] = digest.hexdigest()

    def rows(self, table: str, stream: IO[bytes]) -> Iterator[bytes]:
        digest, count = hashlib.sha256(), 0
        for line in stream:
            digest.update(line)
            count += 1
            row = orjson.loads(line)
            if "block_path" in row and row.get("signal_let_go_at") is None:
                self.referred[row["block_path"]] = row["block_checksum"]
            yield line
        self.tables[table] = {"count": count, "sha256": digest.hexdigest()}

    def settings_file(self, name: str, stream: IO[bytes]) -> bytes:
        content = stream.read()
        self.settings[name] = hashlib.sha256(content).hexdigest()
        return content

    def verified(self, file: Path, described: Mapping[str, Any]) -> Contents:
        if described["rows"] != self.tables:
            raise BadBackup(f"{file}: the rows differ from their checksums")
        # a backup of an earlier version has none
        if described.get("settings", {}) != self.settings:
            raise BadBackup(f"{file}: the settings differ from their checksums")
        for path, checksum in self.referred.items():
            if self.blocks.get(path) != checksum:
                raise BadBackup(
                    f"{file}: signal block {path}"
                    f" {'differs from its checksum' if path in self.blocks else 'is missing'}"
                )
        surplus = self.blocks.keys() - self.referred.keys()
        if surplus:
            raise BadBackup(f"{file}: no row points to signal block {min(surplus)}")
        counts = {table: int(summary["count"]) for table, summary in self.tables.items()}
        return Contents(
            datetime.fromisoformat(self.created_at),
            self.revision,
            counts,
            len(self.blocks),
            self.size_bytes,
            tuple(self.settings),
        )


# Backup: rows and signal blocks in one tar file, the same whichever database they came from,
# verified before it gets its name.
# Members, in this order: `begin.json` with the schema's revision; `settings/NAME`, the files of
# the settings; `blocks/DAY/NAME.block` as they are on disk; `rows/TABLE.jsonl`, a row a line,
# tables before those that point to them; `end.json` with every table's number of rows and
# SHA-256, and the SHA-256 of every file of the settings. A file that was cut off has no end and
# is refused.


def write_backup(
    database: Database,
    blocks: Path,
    file: Path,
    settings: Mapping[str, bytes] = MappingProxyType({}),
) -> Contents:
    """Back up a running or a stopped service, with the files of its settings by name.

    Returns what the file holds, after it has been read back and verified.

    Rows are those of one moment. A signal that the retention rule removes meanwhile is marked as
    let go in the backup. Raises BadBackup when `file` exists, a block is missing or differs from
    its checksum, or the schema is not up to date; OSError when the file cannot be written.
    """
    if file.exists():
        raise BadBackup(f"{file}: is there already; a backup never replaces a file")
    if database.revision() != newest_revision():
        raise BadBackup(
            f"database: its schema is at revision {database.revision()}; a start of the service"
            f" brings it to {newest_revision()}"
        )
    unfinished = file.with_name(f"{file.name}.unfinished")
    unfinished.unlink(missing_ok=True)  # what lies there keeps its own mode
    try:
        # Its owner's alone from the first byte on: it holds signals, and passwords of the settings.
        with open(os.open(unfinished, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as raw:
            with (
                database.snapshot() as connection,
                tarfile.open(fileobj=raw, mode="w", format=tarfile.PAX_FORMAT) as archive,
            ):
                _write_members(archive, database, connection, blocks, settings)
            raw.flush()
            os.fsync(raw.fileno())
        # Read back before it gets its name: a backup that cannot be restored is found today.
        contents = BackupReader().read(unfinished)
        # The name last: a file of this name is a whole backup.
        os.replace(unfinished, file)
    except BaseException:
        unfinished.unlink(missing_ok=True)
        raise
    sync_folder(file.parent)
    return contents


def _write_members(
    archive: tarfile.TarFile,
    database: Database,
    connection: Connection,
    blocks: Path,
    settings: Mapping[str, bytes],
) -> None:
    _add_json(
        archive,
        BEGIN,
        {"format": FORMAT, "created_at": datetime.now(UTC), "revision": database.revision()},
    )
    for name, content in settings.items():
        archive.addfile(_member(f"settings/{name}", len(content)), io.BytesIO(content))
    # Blocks before rows: a signal that the retention rule removes after the snapshot is missing
    # here, and its row, which the snapshot has as it was, can then be written as let go.
    missing = {
        block.path
        for block in block_rows.references(connection)
        if not _add_block(archive, blocks, block)
    }
    _refuse_lost(database, missing)
    described = {}
    for table in _tables_of(connection):
        row_lines = _lines_of(connection, table)
        marked = _let_go(row_lines, missing) if missing and table.name == "windows" else row_lines
        described[str(table.name)] = _add_rows(archive, table, marked)
    digests = {name: hashlib.sha256(content).hexdigest() for name, content in settings.items()}
    _add_json(archive, END, {"rows": described, "settings": digests})


def _add_block(archive: tarfile.TarFile, blocks: Path, block: BlockReference) -> bool:
    try:
        with open(blocks / block.path, "rb") as stream:
            archive.addfile(
                _member(f"blocks/{block.path}", os.fstat(stream.fileno()).st_size), stream
            )
    except FileNotFoundError:
        return False
    return True


def _refuse_lost(database: Database, missing: set[str]) -> None:
    """BadBackup when a block has gone that a row still points to."""
    if not missing:
        return
    with database.read() as connection:
        lost = sorted(missing & {block.path for block in block_rows.references(connection)})
    if lost:
        raise BadBackup(
            f"signal block {lost[0]}: is missing ({len(lost)} in all); nothing was backed up"
        )


def _let_go(row_lines: Iterator[bytes], missing: set[str]) -> Iterator[bytes]:
    now = datetime.now(UTC).replace(tzinfo=None)
    for line in row_lines:
        row = orjson.loads(line)
        yield (
            orjson.dumps(row | {"signal_let_go_at": now}) + b"\n"
            if row["block_path"] in missing
            else line
        )


def _add_rows(archive: tarfile.TarFile, table: Table, row_lines: Iterator[bytes]) -> dict[str, Any]:
    digest, count = hashlib.sha256(), 0
    # A member's size stands before its content, and is known only when all rows were written.
    with tempfile.TemporaryFile() as spooled:
        for line in row_lines:
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


# Restore: the rows and signal blocks of a backup into an empty database and an empty folder, all
# of it or nothing.

SETTINGS = "settings-of-backup"
"""Folder of the restored files of settings, beside that of the blocks."""


def restore_backup(file: Path, database: Database, blocks: Path) -> Contents:
    """Bring back what `write_backup` wrote, from either kind of database into either kind; returns
    what was restored.

    Files of settings come into `SETTINGS` beside the blocks' folder, for somebody to look at: what
    a service runs by is never replaced. The file is verified before anything is written. Rows get
    the backup's schema, which is then migrated to the newest. Raises BadBackup when the file is not
    a whole backup of this program's or an older schema, or the target is not empty.
    """
    contents = BackupReader().read(file)
    if contents.revision not in known_revisions():
        raise BadBackup(
            f"{file}: its schema, revision {contents.revision}, is none that this program knows; it"
            f" knows {newest_revision()}"
        )
    if database.revision() is not None:
        raise BadBackup("database: is not empty; restore goes into a new one")
    if any(blocks.glob("*/*")):
        raise BadBackup(f"{blocks}: is not empty; restore goes into a new folder")
    beside = blocks.parent / SETTINGS
    if contents.settings and beside.exists():
        raise BadBackup(
            f"{beside}: is there already; the settings of the backup go into a new folder"
        )
    # To the backup's schema first, so that its rows fit; to the newest when they are in.
    database.migrate(contents.revision)
    written: list[Path] = []
    try:
        with database.write() as connection:
            _Restorer(connection, blocks, written).read(file)
        database.migrate()
        # The restored store is another one than that of the backup, which may run on.
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
        self._tables = {table.name: table for table in _tables_of(connection)}
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
        with open(
            os.open(folder / name, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb"
        ) as stream:
            stream.write(content)

    def take_rows(self, table: str, lines: Iterator[bytes]) -> None:
        """Insert a table's rows; the blocks they point to are on disk by now."""
        folders = {self._blocks, *(file.parent for file in self._written)}
        for folder in folders if self._written else ():
            sync_folder(folder)
        # a migration may have begun a table with a row of its own
        self._connection.execute(delete(self._tables[table]))
        _insert_lines(self._connection, self._tables[table], lines)
