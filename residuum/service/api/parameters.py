"""Path and query parameters that several routes take."""

from __future__ import annotations

from collections.abc import Collection
from typing import Annotated

from fastapi import Path, Query
from pydantic import AfterValidator, StringConstraints
from pydantic_core import PydanticCustomError

from residuum.nearest_names import known_names
from residuum.service.machines.adding import ENDINGS
from residuum.service.store import NotFound

NAME = r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$"
"""Names of assets, models and baselines: they stand in addresses and rows, never in a file's
path.
"""

TEXT = r"^[^\x00]*$"
"""Free text: any but the character NUL, which PostgreSQL keeps in no text."""


def _unreserved(name: str) -> str:
    if name.endswith(ENDINGS):
        says = "'{name}' is the name of a machine's document; a model's must not end in {endings}"
        raise PydanticCustomError(
            "reserved_name", says, {"name": name, "endings": ", ".join(ENDINGS)}
        )
    return name


NewModelName = Annotated[str, StringConstraints(pattern=NAME), AfterValidator(_unreserved)]
"""The name under which a user stores a model; those of documents that are kept with machines are
none.
"""

# The largest number that JavaScript, and with it the page, tells from its neighbours.
_LARGEST_ID = 2**53 - 1

AssetName = Annotated[str, Path(description="Name of the asset.", pattern=NAME)]
ModelName = Annotated[str, Path(description="Name of the model.", pattern=NAME)]
WindowId = Annotated[int, Path(description="Number of the window.", ge=1, le=_LARGEST_ID)]
RecordId = Annotated[int, Path(description="Number of the record.", ge=1, le=_LARGEST_ID)]
FindingId = Annotated[int, Path(description="Number of the finding.", ge=1, le=_LARGEST_ID)]
AlarmId = Annotated[int, Path(description="Number of the alarm.", ge=1, le=_LARGEST_ID)]
Cursor = Annotated[
    str | None, Query(description="`next_cursor` of the page before.", max_length=200)
]
Begin = Annotated[
    str | None, Query(alias="from", max_length=40, description="ISO 8601; without a zone: UTC.")
]
End = Annotated[
    str | None, Query(alias="to", max_length=40, description="ISO 8601; not part of the span.")
]
# Bounded by number here, and by bytes where rows are read: 500 findings with much evidence took 595
# MiB.
Limit = Annotated[int, Query(description="Most items on the page.", ge=1, le=500)]
SpanBegin = Annotated[
    str, Query(alias="from", max_length=40, description="ISO 8601; without a zone: UTC.")
]
SpanEnd = Annotated[
    str, Query(alias="to", max_length=40, description="ISO 8601; not part of the span.")
]
ChannelNames = Annotated[
    list[str] | None,
    Query(description="Channels to show (default: all).", alias="channel", max_length=64),
]
Points = Annotated[int, Query(description="Most intervals to show.", ge=10, le=20_000)]


def known_channels(channels: list[str] | None, units: Collection[str]) -> list[str] | None:
    """The channels (None: all) of a window with these units; NotFound for one that it has not."""
    for name in channels or ():
        if name not in units:
            raise NotFound(
                f"channel {name[:60]!r}: the window has none of this name;"
                f" {known_names(name, units, 'there are')}"
            )
    return channels
