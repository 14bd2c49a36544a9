"""One service on a data folder and database: a lock of the system on the folder, and one of
PostgreSQL for the folder's identity.

Both end with the process that holds them, however it ends. Two services would both read the buses
and store every window twice.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import structlog
from sqlalchemy import Connection, text
from sqlalchemy.exc import DBAPIError

from residuum.identification.errors import BadInput
from residuum.service.storage.database import SILENCE, Database
from residuum.service.storage.durable_folder import make_folder
from residuum.service.store import StorageUnavailable

log = structlog.get_logger()

LOOK_EVERY = 2.0
"""Seconds between looks at whether the lock is still held."""
_FILE = "service.lock"
_WAYS_ON = (
    "stop that one, or give this one a data folder and a database of its own (--data, --database)"
)


def _nobody(_reason: str) -> None:
    """Told of a lost lock that nobody asks after."""


class ServiceRuns(BadInput):
    """Another service holds the data folder or the database."""


@contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Hold a data folder for this service alone; ServiceRuns where another one holds it, OSError
    where none can be written.
    """
    make_folder(folder)
    # Not inherited: a worker that outlives a killed service would hold the folder for it.
    descriptor = os.open(folder / _FILE, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = os.read(descriptor, 32).decode("ascii", "replace").strip()
            holder_name = f"process {holder}" if holder.isdecimal() else "another process"
            raise ServiceRuns(
                f"data folder {folder}: a service runs on it already ({holder_name}); {_WAYS_ON}"
            ) from None
        # Who holds it, for the refusal of another; the lock itself is the system's, not the text.
        os.truncate(descriptor, 0)
        os.pwrite(descriptor, f"{os.getpid()}\n".encode(), 0)
        yield
    finally:
        os.close(descriptor)


@contextmanager
def database_lock(
    database: Database, identity: str, lost: Callable[[str], None] = _nobody
) -> Iterator[None]:
    """Hold a PostgreSQL database's data folder, by its identity, for this service alone;
    ServiceRuns where another holds it.

    The lock ends with its connection: it is looked after, and taken again over a new one. `lost` is
    told, once, when another service has taken it meanwhile. SQLite needs none: its file has the
    lock of the one folder that it belongs to.
    """
    if database.url.get_backend_name() != "postgresql":
        yield
        return
    lock = _AdvisoryLock(database, identity)
    if not lock.take():
        url = database.url.render_as_string(hide_password=True)
        raise ServiceRuns(
            f"database {url}: a service runs on it already, with a copy of this data folder;"
            f" {_WAYS_ON}"
        )
    stopped = threading.Event()
    thread = threading.Thread(
        target=lock.look_after, args=(stopped, lost), name="service lock", daemon=True
    )
    thread.start()
    try:
        yield
    finally:
        stopped.set()
        # The longest that a look waits, and the longest that its question does.
        thread.join(LOOK_EVERY + SILENCE)
        lock.let_go()


class _AdvisoryLock:
    """A lock of the server that lasts as long as a connection of its own."""

    def __init__(self, database: Database, identity: str) -> None:
        self._database = database
        # PostgreSQL numbers its advisory locks by 64 bits with a sign.
        self._number = int.from_bytes(
            hashlib.sha256(identity.encode()).digest()[:8], "big", signed=True
        )
        self._held = ExitStack()
        self._connection: Connection | None = None
        self._sessions: set[int] = set()
        """Sessions of the server that hold it for us, or may: of one whose answer was lost, it is
        not known.
        """

    def take(self) -> bool:
        """Whether it is held now, over a new connection; a session of ours that the server still
        believes in is ended first.

        StorageUnavailable where the connection is lost meanwhile, or a session of ours has not
        ended yet.
        """
        connection = self._held.enter_context(self._database.held_open())
        try:
            self._sessions.add(connection.scalar(text("SELECT pg_backend_pid()")))
            if self._free(connection):
                self._connection = connection
                return True
            # After a partition the server may still believe in the session of ours that was lost,
            # and would hold the lock for it: that one is ended, another service's is not.
            holders = set(connection.scalars(_HOLDERS, {"number": self._number}))
            for ours in holders & self._sessions:
                connection.execute(text("SELECT pg_terminate_backend(:session)"), {"session": ours})
        except DBAPIError as error:
            raise StorageUnavailable(f"database: {str(error.orig).splitlines()[0]}") from error
        self.let_go()
        # Ending takes the server a moment: the next look takes the lock.
        if holders <= self._sessions:
            raise StorageUnavailable(
                "database: a session of this service that held the lock of the data folder ends"
            )
        return False

    def _free(self, connection: Connection) -> bool:
        """Whether nobody held it; then this session does."""
        return bool(
            connection.scalar(
                text("SELECT pg_try_advisory_lock(:number)"), {"number": self._number}
            )
        )

    def let_go(self) -> None:
        """Close the connection, and with it the lock."""
        self._connection = None
        with suppress(StorageUnavailable):
            self._held.close()

    def look_after(self, stopped: threading.Event, lost: Callable[[str], None]) -> None:
        """Take the lock again whenever its connection is gone, until `stopped`."""
        while not stopped.wait(LOOK_EVERY):
            try:
                if self._stands():
                    continue
                self.let_go()
                if not self.take():
                    lost(
                        "another service has taken the data folder while the database was away;"
                        " this one ends"
                    )
                    return
                log.info("the lock of the data folder is held again, over a new connection")
            except StorageUnavailable as error:
                log.warning("the lock of the data folder is to be taken again", reason=str(error))
                self.let_go()

    def _stands(self) -> bool:
        """Whether its connection still answers."""
        if self._connection is None:
            return False
        try:
            self._connection.scalar(text("SELECT 1"))
        except DBAPIError:
            return False
        return True


_HOLDERS = text(
    "SELECT pid FROM pg_locks WHERE locktype = 'advisory' AND granted AND ((classid::bigint << 32)"
    " | objid::bigint) = :number"
)
