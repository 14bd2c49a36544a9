"""Heat lost to the surroundings."""

from residuum.identification.physics.effects.base import Conditions, Contribution, Parameter, Scene, Site
from residuum.identification.physics.effects.thermal.heat_loss import HeatLoss


class AmbientLoss(HeatLoss):
    """Conduction and convection: −h·(T − T_a).

    `h` [balance unit / K] ≥ 0; `T_a` [temperature unit] only where the balance names no ambient.
    """

    id = "ambient-loss"
    title = "Loss to the surroundings"
    equation = "−h·(T − T_a)"
    reference = "Newton 1701"
    sizes = ("h",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("h", 0.0, site.per("temperature"), lower=0.0, meaning="loss per temperature difference"),
            *self.surroundings(site),
        )

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(term=-scene.p["h"] * (scene["temperature"] - self.ambient(scene)))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"h": 0.1 * conditions.magnitude / conditions.span("temperature"), **self.first_ambient(conditions)}]
