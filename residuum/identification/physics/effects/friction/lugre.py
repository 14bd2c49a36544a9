"""Friction of bristles: presliding, Stribeck's fall and sliding in one."""

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


class LuGre(Effect):
    """−F, F' = σ·(v − |v|·F/g(v)), g = τ_c + τ_s·exp(−(v/v_s)²): LuGre's model without its damping of the bristles.

    `tau_c`, `tau_s` [balance unit] ≥ 0; `v_s` [velocity unit] > 0; `sigma` [balance unit / position unit] > 0, the bristles'
    stiffness. With a stiff bristle it is Stribeck's friction.
    """

    id = "lugre"
    title = "LuGre friction"
    equation = "−F, F' = σ·(v − |v|·F/g(v))"
    reference = "C. Canudas de Wit, H. Olsson, K. J. Åström, P. Lischinsky, IEEE Trans. Autom. Control 40 (1995) 419"
    acts_on = ("torque", "force")
    needs = ("velocity",)
    sizes = ("sigma",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        stiffness = quotient(site.unit, product(site.units["velocity"], "s"))
        return (
            Parameter("tau_c", 1e-6, site.unit, lower=1e-12, meaning="friction while sliding"),
            Parameter("tau_s", 0.0, site.unit, lower=0.0, meaning="extra friction at breakaway"),
            Parameter("v_s", 0.1, site.units["velocity"], lower=1e-9, meaning="velocity over which it fades"),
            Parameter("sigma", 0.0, stiffness, lower=0.0, meaning="stiffness of the bristles"),
        )

    def states(self, site: Site) -> Mapping[str, str]:
        return {"F": site.unit}

    def contribution(self, scene: Scene) -> Contribution:
        p, v, force = scene.p, scene["velocity"], scene.x["F"]
        g = p["tau_c"] + p["tau_s"] * sp.exp(-((v / p["v_s"]) ** 2))
        return Contribution(term=-force, rates={"F": p["sigma"] * (v - sp.Abs(v) * force / g)}, initial={"F": sp.S.Zero})

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        size, fastest = 0.1 * conditions.magnitude, conditions.largest("velocity")
        travelled = fastest * conditions.sample_time
        return [
            {"tau_c": size, "tau_s": 0.3 * size, "v_s": 0.1 * fastest, "sigma": size / (steps * travelled)}
            for steps in (5.0, 30.0)
        ]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example()]
