"""Where a fleet's records are: a folder, a bucket or archive by its URL, or the windows that a service has stored."""

from __future__ import annotations

import os
import shutil
import tempfile
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from pathlib import Path, PurePosixPath
from typing import Any, Protocol

from sqlalchemy import select

from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.identification.record_formats import OLDER, READERS
from residuum.identification.record_formats.read_apart import read_safely
from residuum.service.storage.blocks import Blocks, BrokenBlock
from residuum.service.storage.database import Database, sqlite_file
from residuum.service.storage.tables import windows

_ENDINGS = READERS | OLDER
_DATABASES = ("sqlite", "postgresql")


class Unreachable(Exception):
    """The place of the records is away. That says nothing of a record: none is refused, and the run can be gone on with."""


class FleetSource(Protocol):
    """Names of records, and the records themselves; travels to worker processes."""

    def items(self) -> list[str]:
        """All names, in an order that is always the same."""

    def read(self, item: str) -> Record:
        """The record of a name; BadInput when it cannot be read."""


@dataclass(frozen=True)
class Folder:
    """Record files below a folder, at any depth; a name is the file's path."""

    folder: str = "."

    def __str__(self) -> str:
        return self.folder

    def items(self) -> list[str]:
        """Paths of the files, sorted; BadInput for one that no line of results could name."""
        found = sorted(str(file) for file in Path(self.folder).rglob("*") if file.suffix.lower() in _ENDINGS)
        if nameless := next((file for file in found if _is_no_text(file)), None):
            raise BadInput(f"{os.fsencode(nameless)!r}: is a file name that is not UTF-8; rename the file")
        return found

    def read(self, item: str) -> Record:
        """The record of a file."""
        return read_safely(item)


@dataclass(frozen=True)
class Bucket:
    """Record files below a URL that fsspec opens: `s3://bucket/plant`, `file:///srv`, `zip::file:///srv/plant.zip`.

    Who may read it is said by the environment, as the library of its protocol wants it (for s3 the AWS variables).
    """

    url: str

    def __str__(self) -> str:
        return self.url

    def items(self) -> list[str]:
        """Keys of the files, sorted."""
        try:
            files, root = _file_system(self.url)
            found = files.find(root)
        except BadInput:
            raise
        except Exception as error:  # a protocol's library has errors of its own
            raise BadInput(f"{self.url}: cannot be listed: {type(error).__name__} {error}") from None
        return sorted(str(key) for key in found if PurePosixPath(key).suffix.lower() in _ENDINGS)

    def read(self, item: str) -> Record:
        """The record of a file, copied here first because readers want files."""
        files, _ = _file_system(self.url)
        with tempfile.TemporaryDirectory() as folder:
            here = Path(folder) / PurePosixPath(item).name
            try:
                with files.open(item, "rb") as there, here.open("wb") as copy:
                    shutil.copyfileobj(there, copy)
                return _named(read_safely(here), item)
            except BadInput as error:
                raise BadInput(str(error).replace(str(here), item)) from None
            except OSError as error:
                raise BadInput(f"{item}: cannot be read: {error}") from None
            except Exception as error:  # a protocol's library has errors of its own, which cannot always leave the worker
                raise Unreachable(f"{item}: cannot be reached: {type(error).__name__} {error}") from None


@dataclass(frozen=True)
class StoredWindows:
    """Windows in a service's database whose signals are still kept; a name is `ASSET/NUMBER`. Nothing is changed.

    Parameters
    ----------
    url : str
        SQLAlchemy URL of the database.
    data : str
        The service's data folder, which has the signal blocks.
    """

    url: str
    data: str

    def __str__(self) -> str:
        return self.url

    def items(self) -> list[str]:
        """Names of the windows, by asset, oldest first."""
        if (file := sqlite_file(self.url)) is not None and not file.is_file():
            raise BadInput(f"{self.url}: there is no such database")
        database, _ = stored_in(self.url, self.data)
        database.refuse_other_revision()
        query = select(windows.c.asset_id, windows.c.id).where(windows.c.signal_let_go_at.is_(None))
        with database.read() as connection:
            rows = connection.execute(query.order_by(windows.c.asset_id, windows.c.id)).all()
        return [f"{row.asset_id}/{row.id}" for row in rows]

    def read(self, item: str) -> Record:
        """The signals of a window, verified."""
        database, blocks = stored_in(self.url, self.data)
        asset, _, number = item.rpartition("/")
        query = select(windows.c.block_path, windows.c.block_checksum).where(
            windows.c.asset_id == asset, windows.c.id == int(number)
        )
        with database.read() as connection:
            row = connection.execute(query).one_or_none()
        try:
            if row is None:
                raise BadInput(f"window {item}: was let go meanwhile")
            return blocks.read(row.block_path, checksum=row.block_checksum)
        except BrokenBlock as error:
            raise BadInput(f"window {item}: {error}") from None


def fleet_source(text: str, data: Path | None) -> FleetSource:
    """What a command's argument names; BadInput for a folder that is none and a database without its data folder."""
    scheme = text.split("://", maxsplit=1)[0].split("+", maxsplit=1)[0] if "://" in text else ""
    if scheme in _DATABASES:
        if data is None or not data.is_dir():
            raise BadInput(f"{text}: the signals of a database are in the service's data folder; give it with --data")
        return StoredWindows(text, str(data.resolve()))
    if scheme:
        return Bucket(text)
    if not Path(text).is_dir():
        raise BadInput(f"{text}: is not a folder")
    return Folder(text)


@lru_cache(maxsize=4)
def _file_system(url: str) -> tuple[Any, str]:
    try:
        fsspec: Any = import_module("fsspec.core")  # optional: the extra `fleet`
    except ImportError:
        raise BadInput(f"{url}: needs the extra `fleet`: pip install 'residuum[fleet]'") from None
    files, root = fsspec.url_to_fs(url)
    return files, root


@lru_cache(maxsize=4)
def stored_in(url: str, data: str) -> tuple[Database, Blocks]:
    """A service's database and signal blocks, opened once a process."""
    return Database(url), Blocks(Path(data) / "blocks")


def _is_no_text(name: str) -> bool:
    """Whether a name of the file system holds bytes that are no UTF-8."""
    return any("\ud800" <= character <= "\udfff" for character in name)


def _named(record: Record, source: str) -> Record:
    return Record(record.channels, record.units, record.sample_time, t0=record.t0, notes=record.notes, source=source)
