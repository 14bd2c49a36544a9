"""One service on a data folder and database: a lock of the system on the folder, and one of PostgreSQL for the folder's identity.

Both end with the process that holds them, however it ends. Two services would both read the buses and store every window twice.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sqlalchemy import text

from residuum.identification.errors import BadInput
from residuum.service.storage.database import Database
from residuum.service.storage.durable_folder import make_folder

_FILE = "service.lock"
_WAYS_ON = "stop that one, or give this one a data folder and a database of its own (--data, --database)"


class ServiceRuns(BadInput):
    """Another service holds the data folder or the database."""


@contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Hold a data folder for this service alone; ServiceRuns where another one holds it, OSError where none can be written."""
    make_folder(folder)
    descriptor = os.open(folder / _FILE, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = os.read(descriptor, 32).decode("ascii", "replace").strip()
            who = f"process {holder}" if holder.isdecimal() else "another process"
            raise ServiceRuns(f"data folder {folder}: a service runs on it already ({who}); {_WAYS_ON}") from None
        os.truncate(descriptor, 0)
        os.pwrite(descriptor, f"{os.getpid()}\n".encode(), 0)
        yield
    finally:
        os.close(descriptor)


@contextmanager
def database_lock(database: Database, identity: str) -> Iterator[None]:
    """Hold a PostgreSQL database's data folder, by its identity, for this service alone; ServiceRuns where another holds it.

    SQLite needs none: its file has the lock of the one folder that it belongs to.
    """
    if database.url.get_backend_name() != "postgresql":
        yield
        return
    number = int.from_bytes(hashlib.sha256(identity.encode()).digest()[:8], "big", signed=True)
    with database.held_open() as connection:
        if not connection.scalar(text("SELECT pg_try_advisory_lock(:number)"), {"number": number}):
            url = database.url.render_as_string(hide_password=True)
            raise ServiceRuns(f"database {url}: a service runs on it already, with a copy of this data folder; {_WAYS_ON}")
        yield
