"""What two balances of one kind give each other: heat, flow, force."""

from __future__ import annotations

from residuum.identification.physics.effects.base import Conditions, Contribution, Effect, Example, Parameter, Scene, Site
from residuum.identification.physics.effects.example_models import tank_example

ACROSS = {"heat": "temperature", "volume": "level", "torque": "velocity", "force": "velocity"}
"""Kind of balance → the quantity whose difference drives the exchange."""


class Coupling(Effect):
    """−k·(x − x′), taken from one balance and given to the other: heat exchange, flow between stores, friction between bodies.

    It stands at `balance(other)`, both of one kind. x is the balance's temperature, level or velocity, x′ the other's;
    `k` [balance unit / unit of x] ≥ 0.
    """

    id = "coupling"
    title = "Coupling of two balances"
    equation = "−k·(x − x′), and +k·(x − x′) in the other"
    reference = "D. C. Karnopp, D. L. Margolis, R. C. Rosenberg, System Dynamics, Wiley, ch. 3 (one-port between two junctions)"
    acts_on = tuple(ACROSS)
    sizes = ("k",)
    between = True

    def fits(self, site: Site) -> bool:
        return super().fits(site) and ACROSS[site.kind] in site.units

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("k", 0.0, site.per(ACROSS[site.kind]), lower=0.0, meaning="exchange per difference"),)

    def contribution(self, scene: Scene) -> Contribution:
        mine, other = ACROSS[scene.site.kind], f"other:{ACROSS[scene.site.kind]}"
        exchange = scene.p["k"] * (scene[mine] - scene[other])
        return Contribution(term=-exchange, elsewhere={scene.site.signals[0]: exchange})

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        role = next(role for role in conditions.variables if f"other:{role}" in conditions.variables)
        difference = conditions.variables[role] - conditions.variables[f"other:{role}"]
        return [{"k": 0.1 * conditions.magnitude / (float(abs(difference).max()) or 1.0)}]

    def examples(self) -> list[Example]:
        return [tank_example()]
