"""Effects of electric circuits."""

from collections.abc import Mapping

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import (
    Conditions,
    Contribution,
    Effect,
    Parameter,
    Scene,
    Site,
    product,
    quotient,
)
from residuum.identification.physics.effects.example_models import Example, drive_example


class Inductance(Effect):
    """A voltage balance without storage receives L·di/dt: the current becomes a state with time
    constant L/R.

    `L` [balance unit · s / current unit] > 0. A time constant far below the sample time cannot be
    seen; near it, it resembles an input delay. The current begins where it would settle, or where
    the record says: a machine may be switched on with it.
    """

    id = "inductance"
    title = "Inductance"
    equation = "L·di/dt = Σ voltages"
    reference = "Faraday 1831"
    acts_on = ("voltage",)
    needs = ("current", "defined")

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter(
                "L", 1e-6, product(site.per("current"), "s"), lower=1e-12, meaning="inductance"
            ),
        )

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(inductance=scene.p["L"])

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [
            # The storage of a balance without one is its resistance R: time constants L/R of a
            # fifth, one and five samples.
            {"L": steps * conditions.storage * conditions.sample_time}
            for steps in (0.2, 1.0, 5.0)
        ]

    def examples(self) -> list[Example]:
        return [drive_example()]


class BrushDrop(Effect):
    """−V_b·sign(i): no current flows until the drop is overcome.

    `V_b` [balance unit] ≥ 0. Through K·i it resembles Coulomb friction unless the current is
    recorded.
    """

    id = "brush-drop"
    title = "Brush voltage drop"
    equation = "−V_b·sign(i)"
    reference = "A. E. Fitzgerald et al., Electric Machinery, ch. 7"
    acts_on = ("voltage",)
    needs = ("current",)
    sizes = ("V_b",)
    rest = 0.001

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("V_b", 0.0, site.unit, lower=0.0, meaning="voltage drop of the brushes"),)

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(term=-scene.p["V_b"] * scene.direction)

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        # A twentieth of the supply.
        return [{"V_b": 0.05 * conditions.magnitude}]

    def examples(self) -> list[Example]:
        return [drive_example()]


class SupplySag(Effect):
    """The supply terms, in all u, fall with the current i: −k·|i|·u, by a share for each ampere.

    `k` [1 / current unit] ≥ 0. `p`, fixed, is the power of u by which they fall: 0 for a resistance
    in the supply, −k·u_ref·|i|·sgn(u); 1 for a share; 2 for a chopper, which takes from its supply
    less than the motor's current, by its duty. `fed`, fixed: with 1 only current that the supply
    feeds counts, (|i| + i·sgn(u))/2, with 0 that of braking too.
    """

    id = "supply-sag"
    title = "Supply sag"
    equation = (
        "−k·|i|·supply, or with |supply/u_ref|^p instead of supply; with braking current or without"
    )
    reference = "J. Larminie, J. Lowry, Electric Vehicle Technology Explained, ch. 3"
    acts_on = ("voltage",)
    needs = ("current", "supply")
    sizes = ("k",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        per_current = quotient("1", site.units["current"])
        return (
            Parameter("k", 0.0, per_current, lower=0.0, meaning="relative sag per current"),
            Parameter(
                "p",
                1.0,
                "",
                lower=0.0,
                upper=2.0,
                fixed=True,
                meaning="power of the supply: 0, 1 or 2",
            ),
            Parameter(
                "fed",
                0.0,
                "",
                lower=0.0,
                upper=1.0,
                fixed=True,
                meaning="1: only current that the supply feeds",
            ),
            Parameter(
                "u_ref",
                1.0,
                site.unit,
                lower=1e-12,
                fixed=True,
                meaning="supply at which all powers do the same",
            ),
        )

    def contribution(self, scene: Scene) -> Contribution:
        k, p, fed, u_ref = (scene.p[name] for name in ("k", "p", "fed", "u_ref"))
        u = scene["supply_terms"]
        i = scene["current"]
        z = sp.Abs(u) / u_ref
        way = sp.sign(u)
        # With p = 0, 1, 2 the weights (1−p)(2−p)/2, p(2−p), p(p−1)/2 choose 1, z, z².
        # z^p where p is whole
        share = (1 - p) * (2 - p) / 2 + p * (2 - p) * z + p * (p - 1) / 2 * z**2
        current = (1 - fed / 2) * sp.Abs(i) * way + fed / 2 * i * way**2
        return Contribution(term=-k * u_ref * share * current)

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        k = 0.05 / conditions.largest("current")
        u_ref = (
            conditions.largest("supply_terms")
            if "supply_terms" in conditions.variables
            else conditions.magnitude
        )
        return [
            {"k": k, "p": p, "fed": fed, "u_ref": u_ref}
            for p, fed in ((1.0, 0.0), (0.0, 1.0), (2.0, 1.0))
        ]

    def examples(self) -> list[Example]:
        return [drive_example()]


class ResistanceHeating(Effect):
    """Extra resistance ρ with its own warming: −ρ·i, τ·ρ' = a·i² − ρ.

    `a` [ohm / current unit²] ≥ 0, the extra resistance that a squared current ends at; `tau` [s] >
    0. Records much shorter than tau show only a/tau.
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
        p = scene.p
        i = scene["current"]
        rho = scene.x["rho"]
        return Contribution(
            term=-rho * i,
            rates={"rho": (p["a"] * i**2 - rho) / p["tau"]},
            initial={"rho": sp.S.Zero},
        )

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        size = 0.1 * conditions.storage / conditions.largest("current") ** 2
        return [{"a": size, "tau": fraction * conditions.duration} for fraction in (0.1, 1.0)]

    def examples(self) -> list[Example]:
        return [drive_example()]
