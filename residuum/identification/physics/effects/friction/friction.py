"""What all frictions share: they act on a velocity, and take energy out of it, never in."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from residuum.identification.physics.effects.base import Array, Effect, Example
from residuum.identification.physics.effects.example_models import axis_example, drive_example


class Friction(Effect):
    """Base of the frictions."""

    acts_on = ("torque", "force")
    needs: ClassVar[tuple[str, ...]] = ("velocity",)

    def obeys_physics(self, term: Array, variables: Mapping[str, Array], values: Mapping[str, float]) -> bool:
        """Power term·v ≤ 0 at every sample."""
        return bool(np.all(term * variables["velocity"] <= 0.0))

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example()]
