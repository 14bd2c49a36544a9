"""A load that is another one in every experiment and changes evenly within it: what nobody recorded."""

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
from residuum.identification.physics.effects.example_models import axis_example, drive_example


class DriftingLoad(Effect):
    """−(l + l'·t) with a first value l [balance unit] and a slope l' [balance unit / s] of every experiment's own.

    No effect of the catalogue: it explains nothing, and predicts nothing of a next record. It is what an effect has to do better
    than, where a plant is judged in windows: weather, goods, hands.
    """

    id = "drifting-load"
    title = "Drifting load"
    equation = "−l, l'' = 0"
    reference = "A. C. Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, Cambridge 1989, ch. 2.3"
    acts_on = ("torque", "force")
    needs = ("velocity",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return ()

    def states(self, site: Site) -> Mapping[str, str]:
        return {"load": site.unit, "slope": quotient(site.unit, "s")}

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(
            term=-scene.x["load"],
            rates={"load": scene.x["slope"], "slope": sp.S.Zero},
            initial={"load": sp.S.Zero, "slope": sp.S.Zero},
            deviating=("load", "slope"),
        )

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{}]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example()]
