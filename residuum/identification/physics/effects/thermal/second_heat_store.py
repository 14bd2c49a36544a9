"""A wall or load that takes up heat and gives it back."""

from collections.abc import Mapping

from residuum.identification.physics.effects.base import (
    Conditions,
    Contribution,
    Effect,
    Example,
    Parameter,
    Scene,
    Site,
    product,
)
from residuum.identification.physics.effects.example_models import oven_example


class SecondHeatStore(Effect):
    """C_2·T_2' = G·(T − T_2) and −G·(T − T_2) in the balance.

    `C_2` [balance unit · s / K] > 0, `G` [balance unit / K] ≥ 0. T_2 begins at T, or where the record says.
    """

    id = "second-heat-store"
    title = "Second heat store"
    equation = "−G·(T − T_2), C_2·T_2' = G·(T − T_2)"
    reference = "VDI Heat Atlas, part E"
    acts_on = ("heat",)
    needs = ("temperature",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("C_2", 1.0, product(site.per("temperature"), "s"), lower=1e-9, meaning="heat capacity of the second store"),
            Parameter("G", 0.0, site.per("temperature"), lower=0.0, meaning="conductance between the stores"),
        )

    def states(self, site: Site) -> Mapping[str, str]:
        return {"T_2": site.units["temperature"]}

    def contribution(self, scene: Scene) -> Contribution:
        flow = scene.p["G"] * (scene["temperature"] - scene.x["T_2"])
        return Contribution(
            term=-flow, rates={"T_2": flow / scene.p["C_2"]}, initial={"T_2": scene["temperature"]}, deviating=("T_2",)
        )

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        found = []
        for share, fraction in ((0.3, 0.01), (1.0, 0.05), (1.0, 0.3)):
            C_2 = share * conditions.storage
            found.append({"C_2": C_2, "G": C_2 / (fraction * conditions.duration)})
        return found

    def shows(self, values: Mapping[str, float], conditions: Conditions) -> bool:
        """Whether the second store fills within the record. One that does not is a loss to where its temperature began."""
        return values["C_2"] < values["G"] * conditions.duration

    def examples(self) -> list[Example]:
        return [oven_example()]
