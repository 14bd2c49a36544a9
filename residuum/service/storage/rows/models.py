"""Rows of models and their versions. A version's content is a file of ours (YAML, JSON, or a zip of
JSON and arrays).
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from datetime import datetime
from typing import Any, NamedTuple

from sqlalchemy import Connection, Row, insert, select

from residuum.service.storage.rows import paging, row_checks
from residuum.service.storage.tables import model_versions, models
from residuum.service.store import Conflict, ModelVersion, NotFound, Page, StorageUnavailable

MACHINE = "machine"
"""Kind of the documents that hold a machine's settings; they are no models, and listed only when
asked for.
"""

# All but the content, which may be large: lists and checks of rows do without it.
_DESCRIPTION = [
    *row_checks.labelled(models),
    *(column for column in model_versions.c if column.name != "content"),
]


class NewVersion(NamedTuple):
    """A version of a model to be kept, and who made it."""

    model: str
    kind: str
    content: bytes
    note: str
    by: str | None


def add_version(connection: Connection, new: NewVersion, now: datetime) -> ModelVersion:
    """Insert the next version; the first makes the model. Conflict when the model is of another
    kind.
    """
    model, kind, content, note, by = new
    known = connection.execute(select(models).where(models.c.id == model)).first()
    if known is None:
        first = {"id": model, "kind": kind, "created_at": now, "last_number": 0}
        connection.execute(insert(models).values(row_checks.sealed(models, first)))
    elif known.kind != kind:
        raise Conflict(f"model {model!r}: is a {known.kind} model; a {kind} one needs another name")
    # counted in the model's row, not from its versions: a number is never given twice
    number = (known.last_number if known else 0) + 1
    row_checks.change(connection, models, model, lambda _row: {"last_number": number})
    row = {
        "model_id": model,
        "number": number,
        "created_at": now,
        "created_by": by,
        "note": note,
        "content": content,
        "size_bytes": len(content),
        "checksum": hashlib.sha256(content).hexdigest(),
    }
    connection.execute(insert(model_versions).values(row_checks.sealed(model_versions, row)))
    return ModelVersion(model, kind, number, now, by, note, len(content), str(row["checksum"]))


def page(
    connection: Connection, kind: str | None = None, cursor: str | None = None, limit: int = 100
) -> Page[ModelVersion]:
    """The newest version of every model, by name."""
    newest = (model_versions.c.model_id == models.c.id) & (
        model_versions.c.number == models.c.last_number
    )
    query = (
        select(*_DESCRIPTION)
        .join_from(models, model_versions, newest)
        .order_by(models.c.id)
        .limit(limit + 1)
    )
    query = query.where(models.c.kind == kind if kind is not None else models.c.kind != MACHINE)
    if cursor:
        query = query.where(models.c.id > paging.decode(cursor))
    return paging.page(connection.execute(query).all(), limit, "model_id", _version)


def versions(connection: Connection, model: str) -> Sequence[ModelVersion]:
    """All versions of a model, newest first."""
    query = select(*_DESCRIPTION).join_from(models, model_versions).where(models.c.id == model)
    rows = connection.execute(query.order_by(model_versions.c.number.desc())).all()
    if not rows:
        raise NotFound(f"model {model!r}: there is none of this name; GET /models lists them")
    return [_version(row) for row in rows]


def content(connection: Connection, model: str, number: int | None = None) -> bytes:
    """The content of one version (default: the newest)."""
    query = select(
        model_versions.c.content, model_versions.c.number, model_versions.c.checksum
    ).where(model_versions.c.model_id == model)
    if number is not None:
        query = query.where(model_versions.c.number == number)
    row = connection.execute(query.order_by(model_versions.c.number.desc()).limit(1)).first()
    if row is None:
        reason = f"has no version {number}"
        if number is None:
            reason = "there is none of this name; GET /models lists them"
        raise NotFound(f"model {model!r}: {reason}")
    # Verified at each read: by a baseline that flipped, windows would be judged wrongly in silence.
    if hashlib.sha256(row.content).hexdigest() != row.checksum:
        raise StorageUnavailable(
            f"model {model!r}, version {row.number}: its content differs from its checksum; restore"
            " a backup"
        )
    return bytes(row.content)


def _version(row: Row[Any]) -> ModelVersion:
    if row_checks.differs(model_versions, row._mapping):
        raise row_checks.refuse(f"model {row.model_id!r}, version {row.number}")
    if row_checks.differs(models, row_checks.of_labelled(models, row)):
        raise row_checks.refuse(f"model {row.model_id!r}")
    return ModelVersion(
        row.model_id,
        row.models_kind,
        row.number,
        row.created_at,
        row.created_by,
        row.note,
        row.size_bytes,
        row.checksum,
    )
