"""The sensor's range ends."""

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import Conditions, Contribution, Effect, Example, Parameter, Scene, Site
from residuum.identification.physics.effects.example_models import axis_example, drive_example, oven_example, tank_example


class OutputSaturation(Effect):
    """y limited to at most y_max.

    `y_max` [output unit], the largest reading.
    """

    id = "output-saturation"
    title = "End of the sensor's range"
    equation = "min(y, y_max)"
    reference = "J. Fraden, Handbook of Modern Sensors, ch. 3"
    acts_on = ("output",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("y_max", 1e9, site.unit, meaning="largest reading"),)

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(signal=sp.Min(scene.signal, scene.p["y_max"]))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        highest = float(conditions.variables["signal"].max())
        return [{"y_max": highest - part * conditions.span("signal")} for part in (0.05, 0.2)]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example(), oven_example(), tank_example()]
