"""Flow that has one direction."""

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import Conditions, Contribution, Parameter, Scene, Site
from residuum.identification.physics.effects.hydraulic.drain import Drain


class CheckValve(Drain):
    """−c·max(h − h_0, 0): a valve that opens above the level h_0 and lets nothing back.

    `c` [balance unit / level unit] ≥ 0; `h_0` [level unit] ≥ 0.
    """

    id = "check-valve"
    title = "Check valve"
    equation = "−c·max(h − h_0, 0)"
    reference = "H. E. Merritt, Hydraulic Control Systems, Wiley 1967, ch. 5"
    sizes = ("c",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("c", 0.0, site.per("level"), lower=0.0, meaning="flow per level above the opening"),
            Parameter("h_0", 0.0, site.units["level"], lower=0.0, meaning="level at which it opens"),
        )

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(term=-scene.p["c"] * sp.Max(scene["level"] - scene.p["h_0"], 0))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        size = 0.2 * conditions.magnitude / conditions.span("level")
        return [{"c": size, "h_0": max(conditions.quantile("level", part), 0.0)} for part in (0.3, 0.6)]
