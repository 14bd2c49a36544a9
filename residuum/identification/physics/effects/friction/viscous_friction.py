"""Friction proportional to velocity."""

from residuum.identification.physics.effects.base import Conditions, Contribution, Parameter, Scene, Site
from residuum.identification.physics.effects.friction.friction import Friction


class ViscousFriction(Friction):
    """Lubricated contacts and bearings: −d·v.

    `d` [balance unit / velocity unit] ≥ 0.
    """

    id = "viscous-friction"
    title = "Viscous friction"
    equation = "−d·v"
    reference = "Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083"
    sizes = ("d",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("d", 0.0, site.per("velocity"), lower=0.0, meaning="friction per velocity"),)

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(term=-scene.p["d"] * scene["velocity"])

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"d": 0.1 * conditions.magnitude / conditions.largest("velocity")}]
