"""Dry friction that differs between the two directions."""

from collections.abc import Mapping

import numpy as np

from residuum.identification.physics.effects.base import Conditions, Contribution, Parameter, Scene, Site
from residuum.identification.physics.effects.friction.friction import Friction


class DirectionalFriction(Friction):
    """Forward −τ₊, backward +τ₋: seals, wipers, worm gears under load.

    `tau_plus`, `tau_minus` [balance unit] ≥ 0; a machine may rub in one direction alone.
    """

    id = "directional-friction"
    title = "Directional friction"
    equation = "−τ₊ for v > 0, +τ₋ for v < 0"
    reference = "Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083"
    sizes = ("tau_plus", "tau_minus")
    rest = 0.001
    generalises = "coulomb-friction"
    natural_bounds = ("tau_plus", "tau_minus")

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("tau_plus", 0.0, site.unit, lower=0.0, meaning="friction forwards"),
            Parameter("tau_minus", 0.0, site.unit, lower=0.0, meaning="friction backwards"),
        )

    def contribution(self, scene: Scene) -> Contribution:
        s = scene.direction
        forwards, backwards = s * (s + 1) / 2, s * (s - 1) / 2
        return Contribution(term=-scene.p["tau_plus"] * forwards + scene.p["tau_minus"] * backwards)

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        size = 0.1 * conditions.magnitude
        return [{"tau_plus": size, "tau_minus": 0.5 * size}]

    def specialised(self, general: Mapping[str, float], conditions: Conditions) -> dict[str, float]:
        """Their mean."""
        return {"tau_c": 0.5 * (general["tau_plus"] + general["tau_minus"])}

    def says_more(self, general: Mapping[str, float], std: Mapping[str, float]) -> bool:
        """Not where both sides are equal; it may where the data leave that open, as beside a spring at rest anywhere."""
        doubt = float(np.hypot(std["tau_plus"], std["tau_minus"]))
        return not abs(general["tau_plus"] - general["tau_minus"]) <= 2.0 * doubt < np.inf
