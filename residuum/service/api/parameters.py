"""Path and query parameters that several routes take."""

from __future__ import annotations

from typing import Annotated

from fastapi import Path, Query
from pydantic import AfterValidator, StringConstraints
from pydantic_core import PydanticCustomError

from residuum.service.machines.adding import ENDINGS

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
Limit = Annotated[int, Query(description="Most items on the page.", ge=1, le=500)]
