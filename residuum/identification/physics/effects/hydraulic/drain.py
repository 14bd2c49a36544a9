"""What all drains share: liquid leaves the tank, none comes in."""

from collections.abc import Mapping

import numpy as np

from residuum.identification.physics.effects.base import Array, Effect, Example
from residuum.identification.physics.effects.example_models import tank_example


class Drain(Effect):
    """Base of the outflows."""

    acts_on = ("volume",)
    needs = ("level",)

    def obeys_physics(self, term: Array, variables: Mapping[str, Array], values: Mapping[str, float]) -> bool:
        """Never adds liquid to a tank that holds some."""
        return bool(np.all(term[variables["level"] >= 0.0] <= 0.0))

    def examples(self) -> list[Example]:
        return [tank_example()]
