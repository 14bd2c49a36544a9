"""Cursors of lists: opaque to the caller, the position after the last row for us."""

from __future__ import annotations

import base64
import binascii
from collections.abc import Callable, Collection, Sequence
from typing import Any, NamedTuple

from sqlalchemy import (
    ColumnElement,
    Connection,
    Row,
    Select,
    Text,
    cast,
    false,
    func,
    literal,
    or_,
    true,
)

from residuum.identification.errors import BadInput
from residuum.service.store import Page, T

PAGE_BYTES = 2**20
"""Bytes of the documents (evidence, units, notes, …) on one page of a list, unless its first row
has more.
"""


class Listing(NamedTuple):
    """Rows that hold documents: the query that orders them, the key of each, and the documents, any
    of which may be long.
    """

    query: Select[Any]
    key: ColumnElement[Any]
    documents: Sequence[ColumnElement[Any]]


def encode(position: str | int) -> str:
    """The cursor of a position."""
    return base64.urlsafe_b64encode(str(position).encode()).decode().rstrip("=")


def decode(cursor: str) -> str:
    """The position of a cursor; BadInput when it is none of ours."""
    try:
        return base64.b64decode(
            cursor + "=" * (-len(cursor) % 4), altchars=b"-_", validate=True
        ).decode()
    except (binascii.Error, ValueError):
        raise BadInput(f"cursor {cursor[:40]!r}: is not one that this list gave") from None


def decode_number(cursor: str) -> int:
    """The position of a cursor of a list that is ordered by number."""
    position = decode(cursor)
    # 18 digits fit into the 64 bits that either database compares numbers in
    if not position.isdecimal() or len(position) > 18:
        raise BadInput(f"cursor {cursor[:40]!r}: is not one that this list gave")
    return int(position)


def of_sites(asset: ColumnElement[str], sites: Collection[str] | None) -> ColumnElement[bool]:
    """Whether an asset's name is that of a site, or begins with it and a dot (compared by
    characters, not by LIKE).
    """
    # None is a caller of the whole plant; no site at all sees nothing.
    if sites is None:
        return true()
    return or_(
        false(),
        *(
            (asset == site) | (func.substr(asset, 1, len(site) + 1) == f"{site}.")
            for site in sorted(sites)
        ),
    )


def by_bytes(
    connection: Connection, listing: Listing, limit: int, most: int = PAGE_BYTES
) -> tuple[Sequence[Row[Any]], bool]:
    """The first rows of a listing, at most so many, whose documents take at most `most` bytes, and
    whether there are more.

    The sizes are asked for first: a row's documents as values of Python take ten times their bytes.
    One row is always given.
    """
    # 500 findings with much evidence took 595 MiB, and five such lists 2.4 GiB, when rows were read
    # before anybody knew how long they are.
    query, key, documents = listing
    size: ColumnElement[int] = sum(
        (func.coalesce(func.length(cast(part, Text)), 0) for part in documents), literal(0)
    )
    # one row more than asked for, whose documents are never read, tells whether there are more
    sizes = connection.execute(
        query.with_only_columns(key, size, maintain_column_froms=True).limit(limit + 1)
    ).all()
    keys: list[Any] = []
    held = 0
    for number, part in sizes[:limit]:
        held += part
        if keys and held > most:
            break
        keys.append(number)
    rows = connection.execute(query.where(key.in_(keys))).all() if keys else []
    return rows, len(sizes) > len(keys)


def page_by_bytes(
    connection: Connection,
    listing: Listing,
    limit: int,
    position: str,
    make: Callable[[Row[Any]], T],
) -> Page[T]:
    """A page of at most so many rows and bytes; `position` names the column the list is ordered by,
    as in `page`.
    """
    rows, more = by_bytes(connection, listing, limit)
    return Page([make(row) for row in rows], encode(getattr(rows[-1], position)) if more else None)


def page(
    rows: Sequence[Row[Any]], limit: int, position: str, make: Callable[[Row[Any]], T]
) -> Page[T]:
    """A page of rows of which one more than `limit` was asked for; `position` names the column the
    list is ordered by.
    """
    shown = rows[:limit]
    more = encode(getattr(shown[-1], position)) if len(rows) > limit else None
    return Page([make(row) for row in shown], more)
