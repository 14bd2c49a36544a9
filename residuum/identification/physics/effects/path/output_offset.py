"""The sensor reads too much or too little."""

from residuum.identification.physics.effects.base import Conditions, Contribution, Effect, Example, Parameter, Scene, Site
from residuum.identification.physics.effects.example_models import axis_example, drive_example, oven_example, tank_example


class OutputOffset(Effect):
    """y + y_0.

    `y_0` [output unit].
    """

    id = "output-offset"
    title = "Output offset"
    equation = "y + y_0"
    reference = "JCGM 200:2012, 4.20"
    acts_on = ("output",)
    sizes = ("y_0",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("y_0", 0.0, site.unit, meaning="offset"),)

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(signal=scene.signal + scene.p["y_0"])

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"y_0": 0.05 * conditions.largest("signal")}]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example(), oven_example(), tank_example()]
