"""Play between the command and what it moves."""

from collections.abc import Mapping

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import Conditions, Contribution, Effect, Example, Parameter, Scene, Site
from residuum.identification.physics.effects.example_models import axis_example, drive_example, oven_example, tank_example


class InputBacklash(Effect):
    """Play: u_b follows u once it is more than w behind; τ·u_b' = dead zone of ±w of (u − u_b), τ short.

    `w` [input unit] > 0, half the play; `tau` [s], fixed at some samples: linkages, valve stems, gear racks.
    """

    id = "input-backlash"
    title = "Play of an input"
    equation = "τ·u_b' = dead zone of ±w of (u − u_b)"
    reference = "G. Tao, P. V. Kokotović, Adaptive Control of Systems with Actuator and Sensor Nonlinearities, Wiley 1996"
    acts_on = ("input",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("w", 1e-9, site.unit, lower=1e-12, meaning="half the play"),
            Parameter("tau", 1e-3, "s", lower=1e-9, fixed=True, meaning="time in which it is taken up"),
        )

    def states(self, site: Site) -> Mapping[str, str]:
        return {"u_b": site.unit}

    def contribution(self, scene: Scene) -> Contribution:
        u, behind, w = scene.signal, scene.x["u_b"], scene.p["w"]
        away = u - behind
        pulled = sp.Piecewise((away - w, away > w), (away + w, away < -w), (0, True))
        return Contribution(signal=behind, rates={"u_b": pulled / scene.p["tau"]}, initial={"u_b": u})

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"w": part * conditions.largest("signal"), "tau": 2.0 * conditions.sample_time} for part in (0.03, 0.15)]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example(), oven_example(), tank_example()]
