"""The sensor's gain changes over its range."""

from residuum.identification.physics.effects.base import Conditions, Contribution, Effect, Example, Parameter, Scene, Site
from residuum.identification.physics.effects.example_models import axis_example, drive_example, oven_example, tank_example


class OutputGainCurve(Effect):
    """y·(1 + c·y/y_0): a reading that bends.

    `c` [1], −0.9 … 0.9, the gain's relative change at y_0; `y_0` [output unit], fixed at a large reading.
    """

    id = "output-gain-curve"
    title = "Bent gain of a sensor"
    equation = "y·(1 + c·y/y_0)"
    reference = "J. Fraden, Handbook of Modern Sensors, ch. 3 (nonlinearity)"
    acts_on = ("output",)
    sizes = ("c",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("c", 0.0, "", lower=-0.9, upper=0.9, meaning="change of the gain at y_0"),
            Parameter("y_0", 1.0, site.unit, lower=1e-12, fixed=True, meaning="reading at which it is told"),
        )

    def contribution(self, scene: Scene) -> Contribution:
        y = scene.signal
        return Contribution(signal=y * (1 + scene.p["c"] * y / scene.p["y_0"]))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"c": 0.1, "y_0": conditions.largest("signal")}]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example(), oven_example(), tank_example()]
