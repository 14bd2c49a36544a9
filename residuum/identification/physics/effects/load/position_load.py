"""A load that changes slowly along the travel."""

from collections.abc import Mapping

import numpy as np

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import (
    Conditions,
    Contribution,
    Effect,
    Example,
    Parameter,
    Scene,
    Site,
    quotient,
)
from residuum.identification.physics.effects.example_models import axis_example, drive_example


class PositionLoad(Effect):
    """Unbalanced arms, slopes, cranks: −(a·sin κq + b·cos κq), a wave of at most a few periods over the travel.

    `a`, `b` [balance unit]; `kappa` [rad / position unit] > 0, the wave number. Over less than half a period it cannot be
    told from a
    spring with preload.
    """

    id = "position-load"
    title = "Position-dependent load"
    equation = "−(a·sin κq + b·cos κq)"
    reference = "J. Norton, Design of Machinery, McGraw-Hill, ch. 11"
    acts_on = ("torque", "force")
    needs = ("position",)
    sizes = ("a", "b")
    generalises = "linear-spring"

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("a", 0.0, site.unit, meaning="sine amplitude"),
            Parameter("b", 0.0, site.unit, meaning="cosine amplitude"),
            Parameter("kappa", 1.0, quotient("rad", site.units["position"]), lower=1e-9, meaning="wave number"),
        )

    def contribution(self, scene: Scene) -> Contribution:
        p, angle = scene.p, scene.p["kappa"] * scene["position"]
        return Contribution(term=-(p["a"] * sp.sin(angle) + p["b"] * sp.cos(angle)))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        size, travel = 0.1 * conditions.magnitude, conditions.span("position")
        waves = [*(np.pi * periods / travel for periods in (1.0, 2.0, 4.0)), 1.0]  # the last: once a turn, an arm's own weight
        return [{"a": size, "b": size, "kappa": float(kappa)} for kappa in waves]

    def grown(self, special: Mapping[str, float], conditions: Conditions) -> list[dict[str, float]]:
        """Waves that have the spring's stiffness at q = 0: of about half a period, and of one a radian (an arm's own weight)."""
        waves = (1.0, 2.0 / conditions.span("position"))
        return [{"a": special["k"] / kappa, "b": special["tau_0"], "kappa": kappa} for kappa in waves]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example()]
