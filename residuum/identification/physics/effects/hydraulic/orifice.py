"""Flow through an orifice to or from another level."""

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import Conditions, Contribution, Effect, Example, Parameter, Scene, Site
from residuum.identification.physics.effects.example_models import tank_example

_LEAST = 1e-4


class Orifice(Effect):
    """−c·sign(h − h_0)·√|h − h_0|, both ways: a pipe to a neighbour whose level h_0 stays, or that ends below the tank's zero.

    `c` [balance unit / √level unit] ≥ 0; `h_0` [level unit], the level beyond.
    """

    id = "orifice"
    title = "Orifice to a constant level"
    equation = "−c·sign(h − h_0)·√|h − h_0|"
    reference = "H. E. Merritt, Hydraulic Control Systems, Wiley 1967, ch. 3"
    acts_on = ("volume",)
    needs = ("level",)
    sizes = ("c",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("c", 0.0, site.per("level", 0.5), lower=0.0, meaning="orifice area times √(2g)"),
            Parameter("h_0", 0.0, site.units["level"], meaning="level beyond the orifice"),
        )

    def contribution(self, scene: Scene) -> Contribution:
        difference = scene["level"] - scene.p["h_0"]
        return Contribution(term=-scene.p["c"] * difference / sp.sqrt(sp.Abs(difference) + sp.Float(_LEAST)))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        size = 0.1 * conditions.magnitude / conditions.span("level") ** 0.5
        beyond = (conditions.quantile("level", 0.1), conditions.quantile("level", 0.5), -0.5 * conditions.span("level"))
        return [{"c": size, "h_0": h} for h in beyond]

    def examples(self) -> list[Example]:
        return [tank_example()]
