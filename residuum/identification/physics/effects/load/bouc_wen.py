"""A restoring force with a memory."""

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
    quotient,
)
from residuum.identification.physics.effects.example_models import axis_example, drive_example


class BoucWen(Effect):
    """−z, z' = A·v − β·|v|·z − γ·v·|z| (exponent one): joints, mounts, steel, piezos.

    `A` [balance unit / position unit] ≥ 0; `beta` ≥ 0 and `gamma`, either sign [1 / position unit]. With γ = 0 it is Dahl's
    presliding friction of size A/β.
    """

    id = "bouc-wen"
    title = "Bouc–Wen hysteresis"
    equation = "−z, z' = A·v − β·|v|·z − γ·v·|z|"
    reference = "Y. K. Wen, J. Eng. Mech. Div. 102 (1976) 249"
    acts_on = ("torque", "force")
    needs = ("velocity",)
    sizes = ("A",)
    generalises = "hysteresis"

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        length = product(site.units["velocity"], "s")
        return (
            Parameter("A", 0.0, quotient(site.unit, length), lower=0.0, meaning="stiffness after a reversal"),
            Parameter("beta", 1.0, quotient("1", length), lower=0.0, meaning="how fast it is lost"),
            Parameter("gamma", 0.0, quotient("1", length), meaning="how fast it softens (or, negative, hardens)"),
        )

    def states(self, site: Site) -> Mapping[str, str]:
        return {"z": site.unit}

    def contribution(self, scene: Scene) -> Contribution:
        p, v, z = scene.p, scene["velocity"], scene.x["z"]
        rate = p["A"] * v - p["beta"] * sp.Abs(v) * z - p["gamma"] * v * sp.Abs(z)
        return Contribution(term=-z, rates={"z": rate}, initial={"z": sp.S.Zero})

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        travelled = conditions.largest("velocity") * conditions.sample_time
        size = 0.2 * conditions.magnitude
        return [{"A": size / d, "beta": 1.0 / d, "gamma": 0.0} for d in (5.0 * travelled, 20.0 * travelled, 80.0 * travelled)]

    def grown(self, special: Mapping[str, float], conditions: Conditions) -> list[dict[str, float]]:
        """The presliding friction that it contains."""
        return [{"A": special["f_c"] / special["x_0"], "beta": 1.0 / special["x_0"], "gamma": 0.0}]

    def specialised(self, general: Mapping[str, float], conditions: Conditions) -> dict[str, float]:
        """The presliding friction with its stiffness and its loss."""
        return {"f_c": general["A"] / general["beta"], "x_0": 1.0 / general["beta"]} if general["beta"] > 0.0 else {}

    def says_more(self, general: Mapping[str, float], std: Mapping[str, float]) -> bool:
        """Not without a γ of its own."""
        return abs(general["gamma"]) > 2.0 * std["gamma"]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example()]
