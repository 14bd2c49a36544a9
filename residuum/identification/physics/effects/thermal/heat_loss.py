"""What all heat losses share: surroundings at a temperature, and heat that only flows towards the colder side."""

from __future__ import annotations

import numpy as np

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import Conditions, Effect, Example, Parameter, Scene, Site
from residuum.identification.physics.effects.example_models import oven_example


class HeatLoss(Effect):
    """Base of the losses to the surroundings; the surroundings' temperature is the balance's `ambient`, else a parameter."""

    acts_on = ("heat",)
    needs = ("temperature",)

    def surroundings(self, site: Site) -> tuple[Parameter, ...]:
        """The parameter `T_a` where the balance names no ambient."""
        if "ambient" in site.units:
            return ()
        unit = site.units["temperature"]
        return (Parameter("T_a", 20.0 + 273.15 + absolute_zero(unit), unit, meaning="temperature of the surroundings"),)

    def ambient(self, scene: Scene) -> sp.Expr:
        """Temperature of the surroundings."""
        return scene.variables["ambient"] if "ambient" in scene.variables else scene.p["T_a"]

    def first_ambient(self, conditions: Conditions) -> dict[str, float]:
        """The lowest temperature on record as a first `T_a`, where there is such a parameter."""
        if "ambient" in conditions.variables:
            return {}
        return {"T_a": float(np.min(conditions.variables["temperature"]))}

    def examples(self) -> list[Example]:
        return [oven_example()]


def absolute_zero(unit: str) -> float:
    """Absolute zero on the scale of a temperature unit.

    >>> absolute_zero("°C"), absolute_zero("K")
    (-273.15, 0.0)
    """
    return -273.15 if unit.strip() in ("°C", "degC", "C") else 0.0
