"""Which data folder and which database belong together: an identity that both hold from the first
start on.

Signal blocks and the rows that name them are in two places. With another database beside a folder
no row would name its blocks, with another folder no signal of a row would be there; the service
refuses to start on either.
"""

from __future__ import annotations

import secrets
from pathlib import Path

from sqlalchemy import delete, insert, select

from residuum.identification.errors import BadInput
from residuum.service.storage.database import Database
from residuum.service.storage.durable_folder import keep_file, make_folder
from residuum.service.storage.rows import block_rows
from residuum.service.storage.tables import identity

_FILE = "identity"
# Newest signals of the rows of which one must be there, where folder or database hold no identity
# yet.
_LOOKED_AT = 100


class OtherDatabase(BadInput):
    """Folder and database do not belong together; the message says which two ways lead on."""


def claim(folder: Path, database: Database) -> str:
    """The identity of a data folder and its database, written into whichever holds none yet.

    Raises OtherDatabase where they hold two, or where one holds none and signals and rows do not
    know each other.
    """
    theirs, ours = _of_database(database), _of_folder(folder)
    if theirs is not None and theirs == ours:
        return theirs
    if theirs is not None and ours is not None:
        raise OtherDatabase(_refusal(folder, database, "belongs to another data folder"))
    strange = _strangers(folder, database)
    if strange is not None:
        raise OtherDatabase(_refusal(folder, database, strange))
    # Where one side holds it, the other gets the same: a first start that was cut off between the
    # two writes goes on.
    known = theirs or ours or secrets.token_hex(16)
    if theirs is None:
        with database.write() as connection:
            connection.execute(insert(identity).values(id=1, folder=known))
    if ours is None:
        _write(folder / _FILE, known)
    return known


def forget(database: Database) -> None:
    """Let a database that was restored belong to no folder yet: the one that it was copied from
    goes on elsewhere.
    """
    with database.write() as connection:
        connection.execute(delete(identity))


def _strangers(folder: Path, database: Database) -> str | None:
    """Why signals and rows cannot belong together; None where they can."""
    with database.read() as connection:
        named = [block.path for block in block_rows.newest(connection, _LOOKED_AT)]
    # Of a hundred signals one is enough: the retention rule may have removed many of them.
    if named:
        known = any((folder / "blocks" / path).is_file() for path in named)
        return None if known else "names signals of which none is there"
    return (
        "names none of the signals that are there"
        if any((folder / "blocks").glob("*/*.block"))
        else None
    )


def _refusal(folder: Path, database: Database, why: str) -> str:
    url = database.url.render_as_string(hide_password=True)
    return (
        f"data folder {folder} and database {url}: the database {why}; nothing was changed. Give"
        " the database that belongs to this folder (--database), or the folder that belongs to"
        " this database (--data)"
    )


def _of_database(database: Database) -> str | None:
    with database.read() as connection:
        return connection.scalar(select(identity.c.folder))


def _of_folder(folder: Path) -> str | None:
    try:
        return (folder / _FILE).read_text(encoding="ascii").strip() or None
    except FileNotFoundError:
        return None


def _write(file: Path, text: str) -> None:
    """Write a small file that is whole on disk, or not there."""
    make_folder(file.parent)
    # Half an identity would be that of another folder, and the next start would be refused.
    keep_file(file, f"{text}\n".encode("ascii"))
