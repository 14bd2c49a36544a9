"""Heat that comes or goes all the time."""

from residuum.identification.physics.effects.base import Conditions, Contribution, Effect, Example, Parameter, Scene, Site
from residuum.identification.physics.effects.example_models import oven_example


class ConstantHeat(Effect):
    """+q_0: electronics beside the sensor, a neighbour, the sun.

    `q_0` [balance unit], either sign.
    """

    id = "constant-heat"
    title = "Constant heat"
    equation = "+q_0"
    reference = "F. P. Incropera, D. P. DeWitt, Fundamentals of Heat and Mass Transfer, ch. 1"
    acts_on = ("heat",)
    sizes = ("q_0",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("q_0", 0.0, site.unit, meaning="heat that is always there"),)

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(term=scene.p["q_0"])

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"q_0": 0.1 * conditions.magnitude}]

    def examples(self) -> list[Example]:
        return [oven_example()]
