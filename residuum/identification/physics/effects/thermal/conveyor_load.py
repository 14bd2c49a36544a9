"""Goods that carry heat away."""

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import Conditions, Contribution, Parameter, Scene, Site
from residuum.identification.physics.effects.thermal.heat_loss import HeatLoss


class ConveyorLoad(HeatLoss):
    """Cold goods enter and leave warm: −G·(T − T_a), times the conveyor signal where the model has an input `conveyor`.

    `G` [balance unit / K] ≥ 0 (mass flow · specific heat); `T_a` as in the ambient loss. Without a recorded conveyor
    signal it cannot be told
    from an ambient loss.
    """

    id = "conveyor-load"
    title = "Conveyor load"
    equation = "−G·(T − T_a)·conveyor"
    reference = "VDI Heat Atlas, part A"
    sizes = ("G",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("G", 0.0, site.per("temperature"), lower=0.0, meaning="mass flow times specific heat"),
            *self.surroundings(site),
        )

    def recorded(self, site: Site) -> bool:
        """Where there is a conveyor signal: else it is an ambient loss by another name."""
        return "conveyor" in site.units

    def contribution(self, scene: Scene) -> Contribution:
        running = scene.variables.get("conveyor", sp.S.One)
        return Contribution(term=-scene.p["G"] * (scene["temperature"] - self.ambient(scene)) * running)

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"G": 0.1 * conditions.magnitude / conditions.span("temperature"), **self.first_ambient(conditions)}]
