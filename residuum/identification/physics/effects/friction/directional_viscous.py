"""Viscous friction that differs between the two directions."""

from collections.abc import Mapping

import numpy as np

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import Conditions, Contribution, Parameter, Scene, Site
from residuum.identification.physics.effects.friction.friction import Friction


class DirectionalViscous(Friction):
    """−d₊·v forwards, −d₋·v backwards: check valves in dampers, screws, wipers.

    `d_plus`, `d_minus` [balance unit / velocity unit] ≥ 0.
    """

    id = "directional-viscous"
    title = "Directional viscous friction"
    equation = "−d₊·v for v > 0, −d₋·v for v < 0"
    reference = "A. Wahrburg et al., Motor-current-based estimation, IEEE Robot. Autom. Lett. 3 (2018) 775"
    sizes = ("d_plus", "d_minus")
    generalises = "viscous-friction"
    natural_bounds = ("d_plus", "d_minus")

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("d_plus", 0.0, site.per("velocity"), lower=0.0, meaning="friction per velocity forwards"),
            Parameter("d_minus", 0.0, site.per("velocity"), lower=0.0, meaning="friction per velocity backwards"),
        )

    def contribution(self, scene: Scene) -> Contribution:
        v = scene["velocity"]
        return Contribution(term=-scene.p["d_plus"] * sp.Max(v, 0) - scene.p["d_minus"] * sp.Min(v, 0))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        size = 0.1 * conditions.magnitude / conditions.largest("velocity")
        return [{"d_plus": size, "d_minus": 0.5 * size}]

    def specialised(self, general: Mapping[str, float], conditions: Conditions) -> dict[str, float]:
        """Their mean."""
        return {"d": 0.5 * (general["d_plus"] + general["d_minus"])}

    def says_more(self, general: Mapping[str, float], std: Mapping[str, float]) -> bool:
        """Not where both sides are equal."""
        return not abs(general["d_plus"] - general["d_minus"]) <= 2.0 * float(np.hypot(std["d_plus"], std["d_minus"])) < np.inf
