"""The sensor's zero wanders off."""

from residuum.identification.physics.effects.base import (
    Conditions,
    Contribution,
    Effect,
    Example,
    Parameter,
    Scene,
    Site,
    quotient,
)
from residuum.identification.physics.effects.example_models import axis_example, drive_example, oven_example, tank_example


class OutputDrift(Effect):
    """y + r·t, t the time since the record's start.

    `r` [output unit / s], either sign.
    """

    id = "output-drift"
    title = "Drift of a sensor"
    equation = "y + r·t"
    reference = "J. Fraden, Handbook of Modern Sensors, ch. 3 (drift)"
    acts_on = ("output",)
    sizes = ("r",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("r", 0.0, quotient(site.unit, "s"), meaning="drift a second"),)

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(signal=scene.signal + scene.p["r"] * scene.t)

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"r": 0.1 * conditions.magnitude / conditions.duration}]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example(), oven_example(), tank_example()]
