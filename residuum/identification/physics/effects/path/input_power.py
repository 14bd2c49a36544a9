"""The actuator answers with a power of its command."""

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import Conditions, Contribution, Effect, Example, Parameter, Scene, Site
from residuum.identification.physics.effects.example_models import axis_example, drive_example, oven_example, tank_example

_LEAST = 1e-9


class InputPower(Effect):
    """u·(|u|/u_0)^e: a propeller's thrust goes with the square of its command (e = 1), a heater's power with that of its voltage.

    `e` [1], −0.9 … 3, the exponent less one; `u_0` [input unit], fixed at its RMS, where nothing changes.
    """

    id = "input-power"
    title = "Power law of an input"
    equation = "u·(|u|/u_0)^e"
    reference = "T. I. Fossen, Handbook of Marine Craft Hydrodynamics and Motion Control, ch. 9 (propeller thrust)"
    acts_on = ("input",)
    sizes = ("e",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("e", 0.0, "", lower=-0.9, upper=3.0, meaning="exponent less one"),
            Parameter("u_0", 1.0, site.unit, lower=1e-12, fixed=True, meaning="input that stays as it is"),
        )

    def contribution(self, scene: Scene) -> Contribution:
        u = scene.signal
        return Contribution(signal=u * (sp.Abs(u) / scene.p["u_0"] + sp.Float(_LEAST)) ** scene.p["e"])

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"e": e, "u_0": conditions.magnitude} for e in (0.5, -0.3)]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example(), oven_example(), tank_example()]
