"""Pump flow that is not proportional to the input."""

from residuum.identification.physics.effects.base import Example
from residuum.identification.physics.effects.example_models import tank_example
from residuum.identification.physics.effects.hydraulic.supply_nonlinearity import SupplyNonlinearity


class PumpNonlinearity(SupplyNonlinearity):
    """Flow that falls behind the input (slip, pipe losses) or follows a power law; equation and parameters as in its base."""

    id = "pump-nonlinearity"
    title = "Pump nonlinearity"
    reference = "J. F. Gülich, Centrifugal Pumps, Springer, ch. 4"
    acts_on = ("volume",)

    def examples(self) -> list[Example]:
        return [tank_example()]
