"""Dry friction at one place of the travel."""

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import Conditions, Contribution, Parameter, Scene, Site, product
from residuum.identification.physics.effects.friction.friction import Friction


class PlaceFriction(Friction):
    """−τ·exp(−((q − q_0)/w)²)·sign(v): a dent in a rail, a rubbing seal, a chip in a screw.

    `tau` [balance unit] ≥ 0; `q_0` [position unit], the place; `w` [position unit] > 0, its half width.
    """

    id = "place-friction"
    title = "Friction at one place"
    equation = "−τ·exp(−((q − q_0)/w)²)·sign(v)"
    reference = "Armstrong-Hélouvry, Control of Machines with Friction, Kluwer 1991, ch. 5 (position-dependent friction)"
    needs = ("velocity", "position")
    sizes = ("tau",)
    rest = 0.001

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        length = site.units["position"] or product(site.units["velocity"], "s")
        return (
            Parameter("tau", 0.0, site.unit, lower=0.0, meaning="friction at the place"),
            Parameter("q_0", 0.0, length, meaning="the place"),
            Parameter("w", 1.0, length, lower=1e-9, meaning="half width of the place"),
        )

    def contribution(self, scene: Scene) -> Contribution:
        p = scene.p
        there = sp.exp(-(((scene["position"] - p["q_0"]) / p["w"]) ** 2))
        return Contribution(term=-p["tau"] * there * scene.direction)

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        size, travel = 0.1 * conditions.magnitude, conditions.span("position")
        lowest = float(conditions.variables["position"].min())
        return [{"tau": size, "q_0": lowest + part * travel, "w": 0.12 * travel} for part in (0.5, 0.2, 0.8, 0.35)]
