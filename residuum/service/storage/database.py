"""The database connection: SQLite (WAL, synchronous=FULL) or PostgreSQL by URL, and its schema
migrations.
"""

from __future__ import annotations

import importlib
import json
import sqlite3
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from alembic import command
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, Engine, create_engine, event
from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import (
    ArgumentError,
    DatabaseError,
    DataError,
    DBAPIError,
    NoSuchModuleError,
    OperationalError,
)
from sqlalchemy.exc import TimeoutError as PoolTimeout

from residuum.identification.errors import BadInput
from residuum.service.settings import BadSettings
from residuum.service.storage.durable_folder import make_folder
from residuum.service.storage.rows.row_checks import seal_rows_of_old
from residuum.service.store import StorageUnavailable

_MIGRATIONS = Path(__file__).parent / "migrations"
# How long a writer waits for another process's lock [s].
_PATIENCE = 10.0
# Writers that wait for each other; beyond, who wants to write is told to come again, so that
# threads are left for readers.
_MOST_WRITERS = 16
# Seconds for which a connection of the pool is waited for. No wait had an end once, and a service
# never recovered from a partition of 60 s.
_POOL_PATIENCE = 10.0

# Bytes of a SQLite file whose structure is looked through in a fraction of a second: 0.2 s of
# processor time, where its rows take some 4 s.
_SMALL = 64 * 2**20


SILENCE, LONG = 8.0, 600.0
"""Seconds without a byte from a server after which a statement is given up; of what may take long
on a large database.
"""


class OutcomeUnknown(StorageUnavailable):
    """The connection was lost while a transaction was being committed: it may stand, or may not."""


class Busy(StorageUnavailable):
    """Others write, or hold the database's lock; nothing was done, and it can be tried again
    soon.
    """


class Database:
    """One database; `read()` and `write()` give a connection in a transaction.

    SQLite writers are queued by a lock of ours, and a write takes the database's lock at its start,
    so that two never meet half-way; readers go on beside it (WAL). `synchronous=FULL`: a commit
    that returned survives a power cut.

    Raises BadSettings when the URL names no usable database, StorageUnavailable when it cannot be
    reached or written.
    """

    def __init__(self, url: str) -> None:
        try:
            self.url = make_url(url)
            self.engine = _engine(self.url)
        except (ArgumentError, NoSuchModuleError, ModuleNotFoundError) as error:
            raise BadSettings(
                f"database {_without_password(url)!r}: {str(error).splitlines()[0]}"
            ) from None
        self._writing, self._writers = threading.Lock(), threading.BoundedSemaphore(_MOST_WRITERS)

    @contextmanager
    def read(self) -> Iterator[Connection]:
        """A connection to read from."""
        with _storage_errors(), self.engine.connect() as connection:
            yield connection

    @contextmanager
    def patiently(self) -> Iterator[None]:
        """What this thread asks within may take long before the server says anything."""
        before, _of_thread.patience = getattr(_of_thread, "patience", None), LONG
        try:
            yield
        finally:
            _of_thread.patience = before

    @contextmanager
    def snapshot(self) -> Iterator[Connection]:
        """A connection that sees one moment, however long it reads."""
        level = (
            {}
            if self.url.get_backend_name() == "sqlite"
            else {"isolation_level": "REPEATABLE READ"}
        )
        # PostgreSQL sees one moment in a transaction of this level; SQLite does in any.
        with _storage_errors(), self.patiently(), self.engine.connect() as connection:
            connection = connection.execution_options(**level)
            if level:  # between two questions files may be written for minutes
                connection.exec_driver_sql("SET LOCAL idle_in_transaction_session_timeout = 0")
            yield connection

    @contextmanager
    def held_open(self) -> Iterator[Connection]:
        """A connection of its own, outside of any transaction, for what lasts as long as the
        connection.
        """
        with _storage_errors(), self.engine.connect() as connection:
            connection = connection.execution_options(isolation_level="AUTOCOMMIT")
            connection.detach()  # or the pool would keep it, and what it holds, when it is closed
            yield connection

    @contextmanager
    def write(self) -> Iterator[Connection]:
        """A connection to write through; committed, and on disk, when the block ends without an
        exception.

        OutcomeUnknown where the answer to the commit was lost, Busy where so many write already
        that this one had to wait long.
        """
        with self._turn(), _storage_errors(), self.engine.connect() as connection:
            connection = connection.execution_options(residuum_write=True)
            transaction = connection.begin()
            try:
                yield connection
            except BaseException:
                with suppress(DBAPIError):  # a connection that is gone has rolled back
                    transaction.rollback()
                raise
            try:
                transaction.commit()
            except DBAPIError as error:
                if error.connection_invalidated:
                    raise OutcomeUnknown(
                        "database: the connection was lost before it said whether all was kept"
                    ) from error
                raise

    @contextmanager
    def _turn(self) -> Iterator[None]:
        """Be the one that writes, after the others of this process."""
        # Bounded: threads that wait to write would leave none to those who read.
        if not self._writers.acquire(blocking=False):
            raise Busy(f"database: {_MOST_WRITERS} others wait to write; try again in some seconds")
        try:
            if not self._writing.acquire(timeout=_PATIENCE):
                raise Busy(
                    f"database: others have been writing for {_PATIENCE:g} s; try again in some"
                    " seconds"
                )
            try:
                yield
            finally:
                self._writing.release()
        finally:
            self._writers.release()

    def migrate(self, revision: str = "head") -> None:
        """Bring the schema to a revision, up or down; BadInput for the schema of a newer
        program.
        """
        current = self.revision()
        if current is not None and current not in known_revisions():
            url = self.url.render_as_string(hide_password=True)
            raise BadInput(
                f"database {url}: its schema, revision {current}, is newer than this program, which"
                f" knows {newest_revision()}; start the program that wrote it, or restore a backup"
                " into a new folder"
            )
        with self.patiently(), self.write() as connection:
            # in this transaction: a migration that fails half-way changes nothing
            config = _alembic()
            config.attributes["connection"] = connection
            down = revision == "base" or (revision.startswith("-") and revision[1:].isdecimal())
            (command.downgrade if down else command.upgrade)(config, revision)
            # A row without a checksum counts as damaged: those of before checksums get theirs here,
            # once.
            if revision == "head" and current is not None:
                seal_rows_of_old(connection, current)

    def revision(self) -> str | None:
        """The schema's revision; None when there are no tables yet."""
        with self.read() as connection:
            return MigrationContext.configure(connection).get_current_revision()

    def looked_through_first(self) -> bool:
        """Whether a start looks through the structure before anything else, rather than beside the
        service: of small files.
        """
        file = Path(self.url.database or "")
        return (
            self.url.get_backend_name() == "sqlite"
            and file.is_file()
            and file.stat().st_size <= _SMALL
        )

    def damage(self) -> str | None:
        """What is wrong with the structure of a SQLite file, as SQLite says; None where nothing is,
        and for other databases.
        """
        if self.url.get_backend_name() != "sqlite":
            return None
        with self.read() as connection:
            # with indexes, unlike quick_check
            says = str(connection.exec_driver_sql("PRAGMA integrity_check(1)").scalar())
        return None if says == "ok" else " ".join(says.split())

    def refuse_other_revision(self) -> None:
        """BadInput when the schema is not this program's: who only reads must not migrate what
        another program may be using.
        """
        if self.revision() != newest_revision():
            url = self.url.render_as_string(hide_password=True)
            raise BadInput(
                f"{url}: is no database of this version of the service; start the service on it"
                " once"
            )

    def close(self) -> None:
        """Close all connections."""
        self.engine.dispose()


def sqlite_file(url: str) -> Path | None:
    """The file of a SQLite database, None for a database of another kind."""
    kind, _, file = url.partition(":///")
    return Path(file) if kind.startswith("sqlite") else None


def newest_revision() -> str:
    """The revision that this program's migrations lead to."""
    return str(ScriptDirectory.from_config(_alembic()).get_current_head())


def known_revisions() -> list[str]:
    """All revisions that this program can migrate from, newest first."""
    return [script.revision for script in ScriptDirectory.from_config(_alembic()).walk_revisions()]


def _alembic() -> Config:
    config = Config()
    config.set_main_option("script_location", str(_MIGRATIONS))
    config.set_main_option("path_separator", "os")
    return config


# `patience`: seconds for which what this thread asks a server for is waited for; None or none: the
# usual ones.
_of_thread = threading.local()


def _engine(url: URL) -> Engine:
    return _sqlite_engine(url) if url.get_backend_name() == "sqlite" else _server_engine(url)


def _sqlite_engine(url: URL) -> Engine:
    in_memory = not url.database or url.database == ":memory:"
    file = None if in_memory else Path(str(url.database))
    if file is not None:
        make_folder(file.parent)
    # The pool gives a connection to one thread at a time, which need not be the one that made it.
    connecting = {"timeout": _PATIENCE, "check_same_thread": False}
    engine = create_engine(url, connect_args=connecting, json_deserializer=_document)

    opened: list[Path] = []

    @event.listens_for(engine, "do_connect")
    def _refuse_to_make_anew(_dialect: Any, _record: Any, _arguments: Any, _more: Any) -> None:
        """A file that has gone while it was in use was moved: SQLite would begin an empty one in
        its place.
        """
        if any(not file.exists() for file in opened):
            raise sqlite3.OperationalError("its file was moved or removed")

    @event.listens_for(engine, "connect")
    def _set_up(connection: Any, _record: Any) -> None:
        connection.isolation_level = None  # transactions are begun by us, below
        # WAL, so that readers go on beside a writer; FULL, since with WAL a commit under NORMAL may
        # be rolled back by a power cut; and SQLite heeds foreign keys only where it is asked to.
        for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON"):
            connection.execute(f"PRAGMA {pragma}")
        if not opened and file is not None:
            opened.append(file)

    @event.listens_for(engine, "begin")
    def _begin(connection: Connection) -> None:
        # A write takes the lock at once: a read that became one later would fail where another
        # wrote in between, without waiting for it.
        write = connection.get_execution_options().get("residuum_write", False)
        connection.exec_driver_sql("BEGIN IMMEDIATE" if write else "BEGIN")

    return engine


def _document(content: str) -> Any:
    """A document in SQLite's file. One that is no JSON any more comes as its text: its row is then
    told as damaged, by name.
    """
    try:
        return json.loads(content)
    except ValueError:
        return content


def _server_engine(url: URL) -> Engine:
    """An engine for a server that may go away: what is asked of it ends in time, and the next asks
    over a new connection.
    """
    # Asked before use: a connection of the pool may have been lost with a server that restarted,
    # and the first question afterwards must not fail for that.
    engine = create_engine(url, pool_pre_ping=True, pool_timeout=_POOL_PATIENCE)
    if url.get_driver_name() == "psycopg":
        # the extra `postgres`
        patient = importlib.import_module("residuum.service.storage.patient_connection")

        @event.listens_for(engine, "do_connect")
        def _connect(_dialect: Any, _record: Any, arguments: Any, options: Any) -> Any:
            return patient.connect(arguments, options)

        @event.listens_for(engine, "before_cursor_execute")
        def _set_patience(connection: Connection, *_: Any) -> None:
            driver: Any = connection.connection.dbapi_connection
            driver.patience = getattr(_of_thread, "patience", None) or SILENCE

        @event.listens_for(engine, "checkin")
        def _reset_patience(connection: Any, _record: Any) -> None:
            if connection is not None:  # None: it was given up
                connection.patience = SILENCE

    return engine


@contextmanager
def _storage_errors() -> Iterator[None]:
    """Failures of disk or server, as StorageUnavailable; values that no column takes, as BadInput;
    ours stay what they are.
    """
    try:
        yield
    except OperationalError as error:
        says = str(error.orig).splitlines()[0]
        if "database is locked" in says:
            locked = (
                f"database: another process has held its lock for {_PATIENCE:g} s; try again in"
                " some seconds"
            )
            # SQLite tells a lock that it has waited for, and a disk that is full, by one kind of
            # error.
            raise Busy(locked) from error
        raise StorageUnavailable(f"database: {says}", full="full" in says.lower()) from error
    except PoolTimeout:
        raise Busy("database: all connections are in use; try again in some seconds") from None
    except DataError as error:
        # PostgreSQL's: NUL in a text, a text longer than its column, a number out of range
        raise BadInput(
            f"database: cannot keep what it was given: {str(error.orig).splitlines()[0]}"
        ) from error
    except DBAPIError as error:
        # the bare class: SQLite's word for a file that is damaged or no database
        if type(error) is DatabaseError:
            raise StorageUnavailable(f"database: {error.orig}") from error
        if error.connection_invalidated:
            raise StorageUnavailable("database: the connection was lost") from error
        raise


def _without_password(url: str) -> str:
    head, at, tail = url.rpartition("@")
    return f"{head.split('://')[0]}://…@{tail}" if at else url


# SamePlace: whether what is open is still what its names mean, so that the next start finds what
# is written now.


class SamePlace:
    """The folder of signal blocks and the file of the database, known by device and inode.

    A folder or file that is moved or removed stays open, and takes writes that nobody ever finds
    again.

    Parameters
    ----------
    places : Path or None
        Folders and files that are there; None for a database that is no file.
    """

    def __init__(self, *places: Path | None) -> None:
        self._known = {place: _identity(place) for place in places if place is not None}

    def check(self) -> None:
        """Raise StorageUnavailable when one of them is not there any more, or another one."""
        for place, known in self._known.items():
            if _identity(place) != known:
                says = (
                    "was moved, removed or replaced while the service runs; put it back, or start"
                    " the service again"
                )
                raise StorageUnavailable(f"{place}: {says}")


def _identity(place: Path) -> tuple[int, int] | None:
    try:
        status = place.stat()
    except OSError:
        return None
    return status.st_dev, status.st_ino
