"""The sensor follows slowly."""

from collections.abc import Mapping

from residuum.identification.physics.effects.base import Conditions, Contribution, Effect, Example, Parameter, Scene, Site
from residuum.identification.physics.effects.example_models import axis_example, drive_example, oven_example, tank_example


class OutputLag(Effect):
    """First-order lag: τ·y_f' = y − y_f, begun at y or where the record says.

    `tau` [s] > 0.
    """

    id = "output-lag"
    title = "Output lag"
    equation = "τ·y_f' = y − y_f"
    reference = "J. Fraden, Handbook of Modern Sensors, ch. 3"
    acts_on = ("output",)
    shifts = "tau"

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("tau", 1e-3, "s", lower=1e-9, meaning="time constant of the sensor"),)

    def states(self, site: Site) -> Mapping[str, str]:
        return {"y_f": site.unit}

    def contribution(self, scene: Scene) -> Contribution:
        y, lagged = scene.signal, scene.x["y_f"]
        return Contribution(signal=lagged, rates={"y_f": (y - lagged) / scene.p["tau"]}, initial={"y_f": y}, deviating=("y_f",))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"tau": steps * conditions.sample_time} for steps in (0.2, 1.0, 5.0, 25.0)]

    def shows(self, values: Mapping[str, float], conditions: Conditions) -> bool:
        """Whether the sensor comes near what it measures within the record. One that begins anywhere and hardly moves would
        make a load of what it measures, and friction of a speed.
        """
        return 2.0 * values["tau"] < conditions.duration

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example(), oven_example(), tank_example()]
