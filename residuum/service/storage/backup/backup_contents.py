"""What a backup file holds, read from its begin to its end and verified on the way."""

from __future__ import annotations

import hashlib
import re
import tarfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import IO, Any

import orjson

from residuum.identification.errors import BadInput

FORMAT = "residuum-backup-1"
BEGIN, END = "begin.json", "end.json"
_BLOCK = re.compile(r"blocks/([0-9]{4}-[0-9]{2}-[0-9]{2}/[0-9a-f]{32}\.block)")
_ROWS = re.compile(r"rows/([a-z_]{1,60})\.jsonl")
_SETTINGS = re.compile(r"settings/([A-Za-z0-9][A-Za-z0-9._-]{0,199})")
_PIECE = 2**20


class BadBackup(BadInput):
    """The file is no backup, is not whole, or differs from its checksums; or there is something where it is to be restored."""


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
    """Reads a backup once and verifies it; a subclass takes what it holds on the way, before the whole is known to be good."""

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
        """Read the whole file: every block against the checksum in its row, every table against the manifest.

        Raises BadBackup with one line that says what is wrong and where.
        """
        seen = _Seen()
        try:
            with tarfile.open(file, "r:") as archive:
                for member in archive:
                    stream = archive.extractfile(member) if member.isreg() else None
                    if stream is None:
                        raise BadBackup(f"{file}: member {member.name[:80]!r} is no plain file")
                    if member.name == END:
                        return seen.verified(file, orjson.loads(stream.read()))
                    self._take(file, member.name, stream, seen)
        except (tarfile.TarError, EOFError, OSError, ValueError, KeyError, TypeError) as error:
            raise BadBackup(f"{file}: is not a whole backup: {error}") from None
        raise BadBackup(f"{file}: is not a whole backup: its end is missing")

    def _take(self, file: Path, name: str, stream: IO[bytes], seen: _Seen) -> None:
        if match := _BLOCK.fullmatch(name):
            self.take_block(match[1], seen.block(match[1], stream))
        elif match := _ROWS.fullmatch(name):
            self.take_rows(match[1], seen.rows(match[1], stream))
        elif match := _SETTINGS.fullmatch(name):
            self.take_settings(match[1], seen.settings_file(match[1], stream))
        elif name == BEGIN:
            seen.begin(file, orjson.loads(stream.read()))
        else:
            raise BadBackup(f"{file}: member {name[:80]!r} does not belong into a backup")


@dataclass
class _Seen:
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
            raise BadBackup(f"{file}: format {str(described['format'])[:40]!r}; this program reads {FORMAT}")
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
        if described.get("settings", {}) != self.settings:  # a backup of an earlier version has none
            raise BadBackup(f"{file}: the settings differ from their checksums")
        for path, checksum in self.referred.items():
            if self.blocks.get(path) != checksum:
                raise BadBackup(
                    f"{file}: signal block {path} {'differs from its checksum' if path in self.blocks else 'is missing'}"
                )
        if surplus := self.blocks.keys() - self.referred.keys():
            raise BadBackup(f"{file}: no row points to signal block {min(surplus)}")
        counts = {table: int(found["count"]) for table, found in self.tables.items()}
        return Contents(
            datetime.fromisoformat(self.created_at),
            self.revision,
            counts,
            len(self.blocks),
            self.size_bytes,
            tuple(self.settings),
        )
