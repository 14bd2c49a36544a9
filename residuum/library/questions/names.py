"""Fields of questions that take one name or several."""

from __future__ import annotations

from collections.abc import Collection
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, ValidationInfo

from residuum.library.questions import OLD_SPELLINGS

_Name = Annotated[str, Field(min_length=1, max_length=200)]
_Several = Annotated[tuple[_Name, ...], Field(max_length=100)]


def _named(given: Any, info: ValidationInfo) -> Any:
    """One name as a list of one; an empty list, which says nothing, as it is written now."""
    # It meant all effects over HTTP and none in Python; now it means that nothing was said.
    if isinstance(given, Collection) and not isinstance(given, str) and len(given) == 0:
        OLD_SPELLINGS.get()(
            f"{info.field_name} {given!r}: will not be read much longer; leave it out"
        )
        return None
    return (given,) if isinstance(given, str) else given


Names = Annotated[
    _Several | None, BeforeValidator(_named, json_schema_input_type=_Name | _Several | None)
]
"""One name or several, which a question then has as a tuple; None: nothing said."""
