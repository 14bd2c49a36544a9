"""Friction that needs some travel to build up."""

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
    product,
)
from residuum.identification.physics.effects.example_models import axis_example, drive_example


class Hysteresis(Effect):
    """Dahl's presliding friction: −f_c·z with x_0·z' = v − |v|·z; after a reversal the friction returns over the distance x_0.

    `f_c` [balance unit] ≥ 0; `x_0` [position unit] > 0. With x_0 → 0 it is Coulomb friction.
    """

    id = "hysteresis"
    title = "Presliding hysteresis"
    equation = "−f_c·z, x_0·z' = v − |v|·z"
    reference = "P. R. Dahl, The Aerospace Corporation TOR-158, 1968"
    acts_on = ("torque", "force")
    needs = ("velocity",)
    sizes = ("f_c",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("f_c", 0.0, site.unit, lower=0.0, meaning="friction once built up"),
            Parameter("x_0", 0.01, product(site.units["velocity"], "s"), lower=1e-9, meaning="distance over which it builds up"),
        )

    def states(self, site: Site) -> Mapping[str, str]:
        return {"z": ""}

    def contribution(self, scene: Scene) -> Contribution:
        v, z = scene["velocity"], scene.x["z"]
        return Contribution(
            term=-scene.p["f_c"] * z,
            rates={"z": (v - sp.Abs(v) * z) / scene.p["x_0"]},
            initial={"z": sp.S.Zero},
        )

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        travelled = conditions.largest("velocity") * conditions.sample_time
        return [{"f_c": 0.1 * conditions.magnitude, "x_0": steps * travelled} for steps in (2.0, 10.0, 50.0)]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example()]
