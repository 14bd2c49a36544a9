"""Heating power that is not proportional to the input."""

from residuum.identification.physics.effects.base import Example
from residuum.identification.physics.effects.example_models import oven_example
from residuum.identification.physics.effects.hydraulic.supply_nonlinearity import SupplyNonlinearity


class HeaterNonlinearity(SupplyNonlinearity):
    """Power that follows a power law of the input (P ∝ u², lamps) or saturates; equation and parameters as in its base."""

    id = "heater-nonlinearity"
    title = "Heater nonlinearity"
    reference = "D. C. Agrawal, Eur. J. Phys. 32 (2011) 1 (lamp power law)"
    acts_on = ("heat",)

    def examples(self) -> list[Example]:
        return [oven_example()]
