"""Dry friction of constant magnitude."""

from residuum.identification.physics.effects.base import Conditions, Contribution, Parameter, Scene, Site
from residuum.identification.physics.effects.friction.friction import Friction


class CoulombFriction(Friction):
    """Dry friction: −τ_c·sign(v), and at standstill whatever holds, up to ±τ_c.

    `tau_c` [balance unit] ≥ 0.
    """

    id = "coulomb-friction"
    title = "Coulomb friction"
    equation = "−τ_c·sign(v)"
    reference = "Coulomb 1785; Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083"
    sizes = ("tau_c",)
    rest = 0.001

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("tau_c", 0.0, site.unit, lower=0.0, meaning="friction while sliding"),)

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(term=-scene.p["tau_c"] * scene.direction)

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"tau_c": 0.1 * conditions.magnitude}]
