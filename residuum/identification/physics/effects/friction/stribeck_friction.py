"""Dry friction that falls as motion begins."""

from collections.abc import Mapping

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import Conditions, Contribution, Parameter, Scene, Site
from residuum.identification.physics.effects.friction.friction import Friction


class StribeckFriction(Friction):
    """Stribeck curve: −(τ_c + τ_s·exp(−(v/v_s)²))·sign(v); breakaway needs τ_c + τ_s, sliding τ_c.

    `tau_c`, `tau_s` [balance unit] ≥ 0; `v_s` [velocity unit] > 0, the velocity over which the extra friction fades.
    Where the record never passes slowly through v_s, `tau_s` and `v_s` trade off.
    """

    id = "stribeck-friction"
    title = "Stribeck friction"
    equation = "−(τ_c + τ_s·exp(−(v/v_s)²))·sign(v)"
    reference = "Stribeck 1902; Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083"
    sizes = ("tau_c", "tau_s")
    rest = 0.001
    generalises = "coulomb-friction"

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("tau_c", 0.0, site.unit, lower=0.0, meaning="friction while sliding"),
            Parameter("tau_s", 0.0, site.unit, lower=0.0, meaning="extra friction at breakaway"),
            Parameter("v_s", 0.1, site.units["velocity"], lower=1e-9, meaning="velocity over which it fades"),
        )

    def contribution(self, scene: Scene) -> Contribution:
        p = scene.p
        fading = sp.exp(-((scene["velocity"] / p["v_s"]) ** 2))
        return Contribution(term=-(p["tau_c"] + p["tau_s"] * fading) * scene.direction)

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        size, fastest = 0.1 * conditions.magnitude, conditions.largest("velocity")
        return [{"tau_c": size, "tau_s": size, "v_s": fraction * fastest} for fraction in (0.01, 0.05, 0.2)]

    def specialised(self, general: Mapping[str, float], conditions: Conditions) -> dict[str, float]:
        """The friction while sliding."""
        return {"tau_c": general["tau_c"]}

    def says_more(self, general: Mapping[str, float], std: Mapping[str, float]) -> bool:
        """Not without a rise at rest."""
        return general["tau_s"] > 2.0 * std["tau_s"]

    def grown(self, special: Mapping[str, float], conditions: Conditions) -> list[dict[str, float]]:
        """Dry friction that was too large at speed and too small at rest."""
        tau, fastest = special["tau_c"], conditions.largest("velocity")
        return [{"tau_c": 0.8 * tau, "tau_s": 0.5 * tau, "v_s": fraction * fastest} for fraction in (0.02, 0.1)]
