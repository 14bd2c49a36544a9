"""The actuator follows slowly."""

from collections.abc import Mapping

from residuum.identification.physics.effects.base import Conditions, Contribution, Effect, Example, Parameter, Scene, Site
from residuum.identification.physics.effects.example_models import axis_example, drive_example, oven_example, tank_example


class InputLag(Effect):
    """First-order lag: τ·u_f' = u − u_f, begun at u: amplifiers, valves, propellers that spin up.

    `tau` [s] > 0.
    """

    id = "input-lag"
    title = "Input lag"
    equation = "τ·u_f' = u − u_f"
    reference = "G. F. Franklin, J. D. Powell, A. Emami-Naeini, Feedback Control of Dynamic Systems, ch. 2"
    acts_on = ("input",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("tau", 1e-3, "s", lower=1e-9, meaning="time constant of the actuator"),)

    def states(self, site: Site) -> Mapping[str, str]:
        return {"u_f": site.unit}

    def contribution(self, scene: Scene) -> Contribution:
        u, lagged = scene.signal, scene.x["u_f"]
        return Contribution(signal=lagged, rates={"u_f": (u - lagged) / scene.p["tau"]}, initial={"u_f": u})

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"tau": steps * conditions.sample_time} for steps in (1.0, 5.0, 25.0)]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example(), oven_example(), tank_example()]
