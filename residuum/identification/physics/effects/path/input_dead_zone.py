"""Small inputs have no effect."""

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import Conditions, Contribution, Effect, Example, Parameter, Scene, Site
from residuum.identification.physics.effects.example_models import axis_example, drive_example, oven_example, tank_example


class InputDeadZone(Effect):
    """u − δ above δ, u + δ below −δ, nothing between.

    `delta` [input unit] ≥ 0.
    """

    id = "input-dead-zone"
    title = "Input dead zone"
    equation = "dead zone of ±δ"
    reference = "G. Tao, P. V. Kokotović, Adaptive Control of Systems with Actuator and Sensor Nonlinearities, Wiley 1996"
    acts_on = ("input",)
    sizes = ("delta",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("delta", 0.0, site.unit, lower=0.0, meaning="half width of the dead zone"),)

    def contribution(self, scene: Scene) -> Contribution:
        u, delta = scene.signal, scene.p["delta"]
        return Contribution(signal=sp.Piecewise((u - delta, u > delta), (u + delta, u < -delta), (0, True)))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"delta": 0.05 * conditions.largest("signal")}]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example(), oven_example(), tank_example()]
