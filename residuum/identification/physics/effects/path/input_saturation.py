"""The actuator cannot give more."""

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import Conditions, Contribution, Effect, Example, Parameter, Scene, Site
from residuum.identification.physics.effects.example_models import axis_example, drive_example, oven_example, tank_example


class InputSaturation(Effect):
    """u limited to ±u_max.

    `u_max` [input unit] > 0.
    """

    id = "input-saturation"
    title = "Input saturation"
    equation = "limit to ±u_max"
    reference = "J. C. Doyle et al., ACC 1987, 1015"
    acts_on = ("input",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("u_max", 1e9, site.unit, lower=1e-12, meaning="largest input"),)

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(signal=sp.Min(sp.Max(scene.signal, -scene.p["u_max"]), scene.p["u_max"]))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"u_max": fraction * conditions.largest("signal")} for fraction in (0.95, 0.8, 0.6)]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example(), oven_example(), tank_example()]
