"""What all frictions share: they act on a velocity, and take energy out of it, never in."""

from typing import ClassVar

from residuum.identification.physics.effects.base import Effect, Example
from residuum.identification.physics.effects.example_models import axis_example, drive_example


class Friction(Effect):
    """Base of the frictions."""

    acts_on = ("torque", "force")
    needs: ClassVar[tuple[str, ...]] = ("velocity",)

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example()]
