"""What runs over the rim."""

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import Conditions, Contribution, Parameter, Scene, Site
from residuum.identification.physics.effects.hydraulic.drain import Drain


class Overflow(Drain):
    """Weir: −c·max(h − h_max, 0)^1.5, which runs away, or at `balance(other)` into another store.

    `c` [balance unit / level unit^1.5] ≥ 0; `h_max` [level unit], the rim; `share` ≥ 0 times what runs over reaches the other
    store (above one where that one is the narrower, and both levels are counted in their own units).
    """

    id = "overflow"
    title = "Overflow"
    equation = "−c·max(h − h_max, 0)^1.5, and +share·c·max(h − h_max, 0)^1.5 in another store that it runs into"
    reference = "Poleni 1717"
    sizes = ("c",)
    reaches = True

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        weir = (
            Parameter("c", 0.0, site.per("level", 1.5), lower=0.0, meaning="weir coefficient"),
            Parameter("h_max", 1.0, site.units["level"], meaning="height of the rim"),
        )
        if not site.signals:
            return weir
        return (*weir, Parameter("share", 1.0, "1", lower=0.0, meaning="what the other store rises by, per fall of this one"))

    def contribution(self, scene: Scene) -> Contribution:
        over = scene.p["c"] * sp.Max(scene["level"] - scene.p["h_max"], 0) ** sp.Rational(3, 2)
        if not scene.site.signals:
            return Contribution(term=-over)
        return Contribution(term=-over, elsewhere={scene.site.signals[0]: scene.p["share"] * over})

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        size = conditions.magnitude / (0.1 * conditions.span("level")) ** 1.5
        into = {"share": 1.0} if "other:level" in conditions.variables else {}
        return [{"c": size, "h_max": conditions.quantile("level", f), **into} for f in (0.6, 0.8, 0.95)]
