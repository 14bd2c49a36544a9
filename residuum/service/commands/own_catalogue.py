"""`--catalogue FILE`: effects of a user's own, for one command."""

from pathlib import Path
from typing import Annotated

import typer

from residuum.identification.physics.effects import EFFECTS
from residuum.identification.physics.files.effect_file import read_effects
from residuum.library.questions import help_of
from residuum.library.questions.missing_effect import Explain


def _used(path: Path | None) -> Path | None:
    EFFECTS.use_here(*(read_effects(path) if path is not None else ()))
    return path


# Used before the model is read, which may name them: for that alone `compare` and `estimate` take a
# catalogue, and in no other door; a model that the service or Python has read brought its own. The
# question that a command asks says no more of it.
OwnCatalogue = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help=help_of(Explain.model_fields["catalogue"]), callback=_used),
]
