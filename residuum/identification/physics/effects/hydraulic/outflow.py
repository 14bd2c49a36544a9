"""Free outflow through an orifice."""

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import Conditions, Contribution, Parameter, Scene, Site
from residuum.identification.physics.effects.hydraulic.drain import Drain


class Outflow(Drain):
    """Torricelli's law: −c·√level.

    `c` [balance unit / √level unit] ≥ 0, the area times √(2g).
    """

    id = "outflow"
    title = "Free outflow"
    equation = "−c·√h"
    reference = "Torricelli 1644"
    sizes = ("c",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("c", 0.0, site.per("level", 0.5), lower=0.0, meaning="orifice area times √(2g)"),)

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(term=-scene.p["c"] * sp.sqrt(sp.Max(scene["level"], sp.Float(1e-12))))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"c": 0.1 * conditions.magnitude / conditions.largest("level") ** 0.5}]
