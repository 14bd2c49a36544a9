"""The supply gives way under load."""

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


class SupplySag(Effect):
    """The supply terms, in all u, fall with the current i: −k·|i|·u, by a share for each ampere.

    `k` [1 / current unit] ≥ 0. `p`, fixed, is the power of u by which they fall: 0 for a resistance in the supply,
    −k·u_ref·|i|·sgn(u); 1 for a share; 2 for a chopper, which takes from its supply less than the motor's current, by its duty.
    `fed`, fixed: with 1 only current that the supply feeds counts, (|i| + i·sgn(u))/2, with 0 that of braking too.
    """

    id = "supply-sag"
    title = "Supply sag"
    equation = "−k·|i|·supply, or with |supply/u_ref|^p instead of supply; with braking current or without"
    reference = "J. Larminie, J. Lowry, Electric Vehicle Technology Explained, ch. 3"
    acts_on = ("voltage",)
    needs = ("current", "supply")
    sizes = ("k",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        per_current = quotient("1", site.units["current"])
        return (
            Parameter("k", 0.0, per_current, lower=0.0, meaning="relative sag per current"),
            Parameter("p", 1.0, "", lower=0.0, upper=2.0, fixed=True, meaning="power of the supply: 0, 1 or 2"),
            Parameter("fed", 0.0, "", lower=0.0, upper=1.0, fixed=True, meaning="1: only current that the supply feeds"),
            Parameter("u_ref", 1.0, site.unit, lower=1e-12, fixed=True, meaning="supply at which all powers do the same"),
        )

    def contribution(self, scene: Scene) -> Contribution:
        k, p, fed, u_ref = (scene.p[name] for name in ("k", "p", "fed", "u_ref"))
        u, i = scene["supply_terms"], scene["current"]
        z, way = sp.Abs(u) / u_ref, sp.sign(u)
        share = (1 - p) * (2 - p) / 2 + p * (2 - p) * z + p * (p - 1) / 2 * z**2  # z^p where p is whole
        current = (1 - fed / 2) * sp.Abs(i) * way + fed / 2 * i * way**2
        return Contribution(term=-k * u_ref * share * current)

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        k = 0.05 / conditions.largest("current")
        u_ref = conditions.largest("supply_terms") if "supply_terms" in conditions.variables else conditions.magnitude
        return [{"k": k, "p": p, "fed": fed, "u_ref": u_ref} for p, fed in ((1.0, 0.0), (0.0, 1.0), (2.0, 1.0))]

    def examples(self) -> list[Example]:
        return [drive_example()]
