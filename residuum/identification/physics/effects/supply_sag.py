"""The supply gives way under load."""

from collections.abc import Mapping

import numpy as np
import sympy as sp

from residuum.identification.physics.effects.base import (
    Array,
    Conditions,
    Contribution,
    Effect,
    Example,
    Parameter,
    Scene,
    Site,
    quotient,
)
from residuum.identification.physics.effects.example_models import drive_example


class SupplySag(Effect):
    """Every supply term falls by k for each ampere: −k·|i|·supply.

    `k` [1 / current unit] ≥ 0.
    """

    id = "supply-sag"
    title = "Supply sag"
    equation = "−k·|i|·supply"
    reference = "J. Larminie, J. Lowry, Electric Vehicle Technology Explained, ch. 3"
    acts_on = ("voltage",)
    needs = ("current", "supply")
    sizes = ("k",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("k", 0.0, quotient("1", site.units["current"]), lower=0.0, meaning="relative sag per current"),)

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(term=-scene.p["k"] * sp.Abs(scene["current"]) * scene["supply_terms"])

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"k": 0.05 / conditions.largest("current")}]

    def obeys_physics(self, term: Array, variables: Mapping[str, Array], values: Mapping[str, float]) -> bool:
        """Opposes the supply."""
        return bool(np.all(term * variables["supply_terms"] <= 0.0))

    def examples(self) -> list[Example]:
        return [drive_example()]
