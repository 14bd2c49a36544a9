"""A load that always pulls one way."""

from residuum.identification.physics.effects.base import Conditions, Contribution, Effect, Example, Parameter, Scene, Site
from residuum.identification.physics.effects.example_models import axis_example, drive_example


class ConstantLoad(Effect):
    """Weight, preload, inclination: −τ_0.

    `tau_0` [balance unit], either sign.
    """

    id = "constant-load"
    title = "Constant load"
    equation = "−τ_0"
    reference = "Newton 1687"
    acts_on = ("torque", "force")
    needs = ("velocity",)
    sizes = ("tau_0",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("tau_0", 0.0, site.unit, meaning="load against positive motion"),)

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(term=-scene.p["tau_0"])

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"tau_0": 0.1 * conditions.magnitude}]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example()]
