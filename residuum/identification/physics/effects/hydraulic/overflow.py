"""What runs over the rim."""

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import Conditions, Contribution, Parameter, Scene, Site
from residuum.identification.physics.effects.hydraulic.drain import Drain


class Overflow(Drain):
    """Weir: −c·max(h − h_max, 0)^1.5.

    `c` [balance unit / level unit^1.5] ≥ 0; `h_max` [level unit], the rim.
    """

    id = "overflow"
    title = "Overflow"
    equation = "−c·max(h − h_max, 0)^1.5"
    reference = "Poleni 1717"
    sizes = ("c",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("c", 0.0, site.per("level", 1.5), lower=0.0, meaning="weir coefficient"),
            Parameter("h_max", 1.0, site.units["level"], meaning="height of the rim"),
        )

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(term=-scene.p["c"] * sp.Max(scene["level"] - scene.p["h_max"], 0) ** sp.Rational(3, 2))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        size = conditions.magnitude / (0.1 * conditions.span("level")) ** 1.5
        return [{"c": size, "h_max": conditions.quantile("level", f)} for f in (0.6, 0.8, 0.95)]
