"""The input is shifted."""

from residuum.identification.physics.effects.base import Conditions, Contribution, Effect, Example, Parameter, Scene, Site
from residuum.identification.physics.effects.example_models import axis_example, drive_example, oven_example, tank_example


class InputOffset(Effect):
    """u + u_0.

    `u_0` [input unit].
    """

    id = "input-offset"
    title = "Input offset"
    equation = "u + u_0"
    reference = "JCGM 200:2012, 4.20"
    acts_on = ("input",)
    sizes = ("u_0",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("u_0", 0.0, site.unit, meaning="offset"),)

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(signal=scene.signal + scene.p["u_0"])

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"u_0": 0.05 * conditions.largest("signal")}]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example(), oven_example(), tank_example()]
