"""The winding warms and its resistance grows."""

from collections.abc import Mapping

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
from residuum.identification.physics.effects.example_models import drive_example


class ResistanceHeating(Effect):
    """Extra resistance ρ with its own warming: −ρ·i, τ·ρ' = a·i² − ρ.

    `a` [ohm / current unit²] ≥ 0, the extra resistance that a squared current ends at; `tau` [s] > 0. Records much shorter
    than tau show
    only a/tau.
    """

    id = "resistance-heating"
    title = "Resistance heating"
    equation = "−ρ·i, τ·ρ' = a·i² − ρ"
    reference = "IEC 60034-1, 8.6"
    acts_on = ("voltage",)
    needs = ("current",)
    sizes = ("a",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter(
                "a",
                0.0,
                quotient(site.per("current"), site.units["current"], 2),
                lower=0.0,
                meaning="extra resistance per current squared",
            ),
            Parameter("tau", 60.0, "s", lower=1e-3, meaning="thermal time constant"),
        )

    def states(self, site: Site) -> Mapping[str, str]:
        return {"rho": site.per("current")}

    def contribution(self, scene: Scene) -> Contribution:
        p, i, rho = scene.p, scene["current"], scene.x["rho"]
        return Contribution(term=-rho * i, rates={"rho": (p["a"] * i**2 - rho) / p["tau"]}, initial={"rho": sp.S.Zero})

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        size = 0.1 * conditions.storage / conditions.largest("current") ** 2
        return [{"a": size, "tau": fraction * conditions.duration} for fraction in (0.1, 1.0)]

    def examples(self) -> list[Example]:
        return [drive_example()]
