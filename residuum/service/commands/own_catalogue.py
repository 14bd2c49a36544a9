"""`--catalogue FILE`: effects of a user's own, for one command."""

from pathlib import Path
from typing import Annotated

import typer

from residuum.identification.physics.effects import EFFECTS
from residuum.identification.physics.files.effect_file import read_effects


def _used(path: Path | None) -> Path | None:
    for effect in read_effects(path) if path is not None else ():
        EFFECTS.use_here(effect)
    return path


OwnCatalogue = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="YAML file with your own effects, in addition to the catalogue.", callback=_used),
]
