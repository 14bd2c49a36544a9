"""The input acts later than recorded."""

from collections.abc import Mapping

from residuum.identification.physics.effects.base import Conditions, Contribution, Effect, Example, Parameter, Scene, Site
from residuum.identification.physics.effects.example_models import axis_example, drive_example, oven_example, tank_example


class InputDelay(Effect):
    """u(t − T_d), interpolated between samples.

    `delay` [s] ≥ 0.
    """

    id = "input-delay"
    title = "Input delay"
    equation = "u(t − T_d)"
    reference = "O. J. M. Smith, Chem. Eng. Progress 53 (1957) 217"
    acts_on = ("input",)
    shifts = "delay"
    sizes = ("delay",)
    generalises = "input-delay"

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("delay", 0.0, "s", lower=0.0, meaning="delay"),)

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(delay=scene.p["delay"])

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"delay": steps * conditions.sample_time} for steps in (0.5, 3.0, 12.0)]

    def grown(self, special: Mapping[str, float], conditions: Conditions) -> list[dict[str, float]]:
        """Half a sample to either side: between two samples of a fast input lies a small summit."""
        moves = [part * conditions.sample_time for part in (-0.5, 0.5)]
        return [{"delay": special["delay"] + move} for move in moves if special["delay"] + move > 0.0]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example(), oven_example(), tank_example()]
