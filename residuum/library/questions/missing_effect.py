"""The questions `explain` and `improve`."""

from __future__ import annotations

import re
from typing import Self

from pydantic import model_validator

from residuum.identification.errors import BadInput
from residuum.identification.physics.effects import EFFECTS
from residuum.identification.physics.files.effect_file import effects_in
from residuum.identification.physics.files.yaml_tree import MOST_CHARACTERS
from residuum.library.questions import Question, field
from residuum.library.questions.names import Names

_PLACED = re.compile(r"[^,@:]+([@:][^,@]+)?")


class Explain(Question):
    """Which physical effect is missing in a model?"""

    effects: Names = field(
        None, "Consider only these effects of the catalogue. Default: all that fit the model."
    )
    learned: bool = field(
        False, "Learn a curve over one signal where no effect of the catalogue explains the error."
    )
    seconds: float | None = field(
        None,
        "Longest time for a search [s]; the answer then depends on the machine, and says what was"
        " not tried.",
        gt=0,
        le=1e6,
    )
    catalogue: str | None = field(
        None,
        "Effects of your own in addition to the catalogue: text in YAML.",
        max_length=MOST_CHARACTERS,
    )

    def use_own(self) -> None:
        """Put the effects of the user's own into the catalogue of this work."""
        EFFECTS.use_here(*(effects_in(self.catalogue) if self.catalogue is not None else ()))


class Improve(Explain):
    """A model with the effects that are missing, estimated again: those that are named, or that are
    found.
    """

    add: Names = field(
        None,
        "Effects to add, `id` or `id@balance` (also an input's or output's name);"
        " `learned@balance(signal)`, `forgotten-input@balance(column)` and"
        " `coupling@balance(other)` name what they are tied to. Default: what explain finds, until"
        " the model is adequate.",
    )
    auto: bool = field(False, "Add what explain finds, as where `add` names nothing.")
    free: Names = field(None, "Parameters that the model fixes, to be estimated; no other is.")

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        wrong = [name for name in self.add or () if not _PLACED.fullmatch(name)]
        if wrong:
            raise BadInput(repr(wrong[0]), "add", "must be an effect, or effect@place")
        # Named effects are not searched for: these were once passed over beside `add`.
        for name in ("auto", "effects", "learned"):
            if self.add and getattr(self, name):
                raise BadInput(
                    "", name, "is for a search; leave it out where `add` names the effects"
                )
        return self
