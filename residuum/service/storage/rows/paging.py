"""Cursors of lists: opaque to the caller, the position after the last row for us."""

from __future__ import annotations

import base64
import binascii
from collections.abc import Callable, Collection, Sequence
from typing import Any

from sqlalchemy import ColumnElement, Row, false, func, or_, true

from residuum.identification.errors import BadInput
from residuum.service.store import Page, T


def encode(position: str | int) -> str:
    """The cursor of a position."""
    return base64.urlsafe_b64encode(str(position).encode()).decode().rstrip("=")


def decode(cursor: str) -> str:
    """The position of a cursor; BadInput when it is none of ours."""
    try:
        return base64.b64decode(cursor + "=" * (-len(cursor) % 4), altchars=b"-_", validate=True).decode()
    except (binascii.Error, ValueError):
        raise BadInput(f"cursor {cursor[:40]!r}: is not one that this list gave") from None


def decode_number(cursor: str) -> int:
    """The position of a cursor of a list that is ordered by number."""
    position = decode(cursor)
    if not position.isdecimal() or len(position) > 18:
        raise BadInput(f"cursor {cursor[:40]!r}: is not one that this list gave")
    return int(position)


def of_sites(asset: ColumnElement[str], sites: Collection[str] | None) -> ColumnElement[bool]:
    """Whether an asset's name is that of a site, or begins with it and a dot (compared by characters, not by LIKE)."""
    if sites is None:
        return true()
    return or_(false(), *((asset == site) | (func.substr(asset, 1, len(site) + 1) == f"{site}.") for site in sorted(sites)))


def page(rows: Sequence[Row[Any]], limit: int, position: str, make: Callable[[Row[Any]], T]) -> Page[T]:
    """A page of rows of which one more than `limit` was asked for; `position` names the column the list is ordered by."""
    shown = rows[:limit]
    more = encode(getattr(shown[-1], position)) if len(rows) > limit else None
    return Page([make(row) for row in shown], more)
