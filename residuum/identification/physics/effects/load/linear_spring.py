"""A spring against a reference position."""

from residuum.identification.physics.effects.base import Conditions, Contribution, Effect, Example, Parameter, Scene, Site
from residuum.identification.physics.effects.example_models import axis_example, drive_example


class LinearSpring(Effect):
    """Return springs, elastic hoses and cables: −k·q − τ_0.

    `k` [balance unit / position unit] ≥ 0; `tau_0` [balance unit], the preload at q = 0.
    """

    id = "linear-spring"
    title = "Linear spring"
    equation = "−k·q − τ_0"
    reference = "Hooke 1678"
    acts_on = ("torque", "force")
    needs = ("position",)
    sizes = ("k", "tau_0")

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("k", 0.0, site.per("position"), lower=0.0, meaning="stiffness"),
            Parameter("tau_0", 0.0, site.unit, meaning="preload at q = 0"),
        )

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(term=-scene.p["k"] * scene["position"] - scene.p["tau_0"])

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"k": 0.1 * conditions.magnitude / conditions.span("position"), "tau_0": 0.0}]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example()]
