"""A leak at the bottom."""

from residuum.identification.physics.effects.base import Conditions, Contribution, Parameter, Scene, Site
from residuum.identification.physics.effects.hydraulic.drain import Drain


class Leak(Drain):
    """Laminar leak through a narrow gap: −c·h.

    `c` [balance unit / level unit] ≥ 0.
    """

    id = "leak"
    title = "Leak"
    equation = "−c·h"
    reference = "Hagen 1839, Poiseuille 1840"
    sizes = ("c",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("c", 0.0, site.per("level"), lower=0.0, meaning="leak per level"),)

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(term=-scene.p["c"] * scene["level"])

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"c": 0.1 * conditions.magnitude / conditions.largest("level")}]
