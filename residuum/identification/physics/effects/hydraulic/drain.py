"""What all drains share: liquid leaves the tank, none comes in."""

from residuum.identification.physics.effects.base import Effect, Example
from residuum.identification.physics.effects.example_models import tank_example


class Drain(Effect):
    """Base of the outflows."""

    acts_on = ("volume",)
    needs = ("level",)

    def examples(self) -> list[Example]:
        return [tank_example()]
