"""What heaters and pumps share: a supply that is not proportional to its input."""

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import Conditions, Contribution, Effect, Parameter, Scene, Site

_SMALLEST = 1e-6
"""Least share of the full input at which the power law is still followed: at zero it has no derivative."""


class SupplyNonlinearity(Effect):
    """The supply's gain changes with the input u: supply·((1 + b·w)·w^γ − 1) with w = |u|/u_ref.

    γ follows power laws (lamps, phase control), b a gain that falls or rises evenly (saturating heaters, slipping pumps).
    `b`, `gamma` [1]; `u_ref` [input unit] fixed, where w is 1.
    """

    equation = "supply·((1 + b·w)·w^γ − 1), w = |u|/u_ref"
    needs = ("supply",)
    sizes = ("b", "gamma")

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("b", 0.0, "", meaning="change of the gain over the input's range"),
            Parameter("gamma", 0.0, "", lower=-0.9, upper=5.0, meaning="exponent of the power law beyond 1"),
            Parameter("u_ref", 1.0, site.units["supply"], lower=1e-12, fixed=True, meaning="input at which w is 1"),
        )

    def contribution(self, scene: Scene) -> Contribution:
        p, w = scene.p, sp.Max(sp.Abs(scene["supply"]) / scene.p["u_ref"], sp.Float(_SMALLEST))
        return Contribution(term=scene["supply_terms"] * ((1 + p["b"] * w) * sp.exp(p["gamma"] * sp.log(w)) - 1))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"b": 0.1, "gamma": 0.1, "u_ref": conditions.largest("supply")}]
