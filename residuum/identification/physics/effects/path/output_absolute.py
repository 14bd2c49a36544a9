"""The sensor does not know the direction."""

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import Conditions, Contribution, Effect, Example, Parameter, Scene, Site
from residuum.identification.physics.effects.example_models import drive_example


class OutputAbsolute(Effect):
    """y + a·(|y| − y): with a = 1 only the magnitude is recorded.

    `a` [1], 0 … 1.
    """

    id = "output-absolute"
    title = "Magnitude only"
    equation = "y + a·(|y| − y)"
    reference = "J. Fraden, Handbook of Modern Sensors, ch. 8"
    acts_on = ("output",)
    sizes = ("a",)
    rest = 0.001
    natural_bounds = ("a",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("a", 0.0, "", lower=0.0, upper=1.0, meaning="share of the magnitude"),)

    def contribution(self, scene: Scene) -> Contribution:
        y = scene.signal
        return Contribution(signal=y + scene.p["a"] * (sp.Abs(y) - y))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"a": 1.0}]

    def examples(self) -> list[Example]:
        return [drive_example()]
