"""The questions `explain` and `improve`."""

from __future__ import annotations

from collections.abc import Collection
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, ValidationInfo

from residuum.identification.physics.effects import EFFECTS
from residuum.identification.physics.files.effect_file import effects_in
from residuum.identification.physics.files.yaml_tree import MOST_CHARACTERS
from residuum.library.questions import OLD_SPELLINGS, Question, field

_Name = Annotated[str, Field(min_length=1, max_length=200)]
_Several = Annotated[tuple[_Name, ...], Field(max_length=100)]


def _named(given: Any, info: ValidationInfo) -> Any:
    """One name as a list of one; an empty list, which says nothing, as it is written now."""
    if isinstance(given, Collection) and len(given) == 0:
        OLD_SPELLINGS.get()(f"{info.field_name} {given!r}: will not be read much longer; leave it out")
        return None
    return (given,) if isinstance(given, str) else given


Names = Annotated[_Several | None, BeforeValidator(_named, json_schema_input_type=_Name | _Several | None)]
"""One name or several; None: nothing said."""


class Search(Question):
    """What a search for missing effects may take, and for how long."""

    effects: Names = field(None, "Consider only these effects of the catalogue. Default: all that fit the model.")
    learned: bool = field(False, "Learn a curve over one signal where no effect of the catalogue explains the error.")
    seconds: float | None = field(
        None,
        "Longest time for a search [s]; the answer then depends on the machine, and says what was not tried.",
        gt=0,
        le=1e6,
    )
    catalogue: str | None = field(
        None, "Effects of your own in addition to the catalogue: text in YAML.", max_length=MOST_CHARACTERS
    )

    def use_own(self) -> None:
        """Put the effects of the user's own into the catalogue of this work."""
        EFFECTS.use_here(*(effects_in(self.catalogue) if self.catalogue is not None else ()))


class Explain(Search):
    """Which physical effect is missing in a model?"""
