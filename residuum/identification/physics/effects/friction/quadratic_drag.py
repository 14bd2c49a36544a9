"""Drag of air or liquid, quadratic in velocity."""

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import Conditions, Contribution, Parameter, Scene, Site
from residuum.identification.physics.effects.friction.friction import Friction


class QuadraticDrag(Friction):
    """Fans, fast carriages, stirrers: −c·v·|v|.

    `c` [balance unit / velocity unit²] ≥ 0.
    """

    id = "quadratic-drag"
    title = "Quadratic drag"
    equation = "−c·v·|v|"
    reference = "Rayleigh 1876"
    sizes = ("c",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("c", 0.0, site.per("velocity", 2), lower=0.0, meaning="drag per velocity squared"),)

    def contribution(self, scene: Scene) -> Contribution:
        v = scene["velocity"]
        return Contribution(term=-scene.p["c"] * v * sp.Abs(v))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"c": 0.1 * conditions.magnitude / conditions.largest("velocity") ** 2}]
