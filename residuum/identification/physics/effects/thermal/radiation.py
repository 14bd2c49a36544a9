"""Heat radiated to the surroundings."""

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import Conditions, Contribution, Parameter, Scene, Site
from residuum.identification.physics.effects.thermal.heat_loss import HeatLoss, absolute_zero


class Radiation(HeatLoss):
    """−c·(T⁴ − T_a⁴) with absolute temperatures.

    `c` [balance unit / K⁴] ≥ 0 (emissivity · area · Stefan–Boltzmann constant); `T_a` as in the ambient loss.
    """

    id = "radiation"
    title = "Radiation"
    equation = "−c·(T⁴ − T_a⁴)"
    reference = "Stefan 1879, Boltzmann 1884"
    sizes = ("c",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("c", 0.0, site.per("temperature", 4), lower=0.0, meaning="emissivity · area · Stefan–Boltzmann constant"),
            *self.surroundings(site),
        )

    def contribution(self, scene: Scene) -> Contribution:
        zero = sp.Float(absolute_zero(scene.site.units["temperature"]))
        hot, cold = scene["temperature"] - zero, self.ambient(scene) - zero
        return Contribution(term=-scene.p["c"] * (hot**4 - cold**4))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"c": 0.1 * conditions.magnitude / (300.0**3 * conditions.span("temperature")), **self.first_ambient(conditions)}]
