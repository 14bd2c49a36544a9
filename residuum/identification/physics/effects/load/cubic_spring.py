"""A spring that hardens (or softens) with the cube of its deflection."""

from residuum.identification.physics.effects.base import Conditions, Contribution, Effect, Example, Parameter, Scene, Site
from residuum.identification.physics.effects.example_models import axis_example, drive_example


class CubicSpring(Effect):
    """Membranes, Duffing oscillators: −k₃·d³ − k₂·d² with the deflection d = q − q_0.

    `k_3` [balance unit / position unit³], negative for a softening spring; `k_2` [balance unit / position unit²], its asymmetry;
    `q_0` [position unit] fixed, where it is at rest.
    """

    id = "cubic-spring"
    title = "Cubic spring"
    equation = "−k₃·(q − q_0)³ − k₂·(q − q_0)²"
    reference = "G. Duffing, Erzwungene Schwingungen bei veränderlicher Eigenfrequenz, 1918"
    acts_on = ("torque", "force")
    needs = ("position",)
    sizes = ("k_3", "k_2")

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("k_3", 0.0, site.per("position", 3), meaning="cubic stiffness"),
            Parameter("k_2", 0.0, site.per("position", 2), meaning="asymmetry"),
            Parameter("q_0", 0.0, site.units["position"], fixed=True, meaning="where it is at rest"),
        )

    def contribution(self, scene: Scene) -> Contribution:
        p, deflection = scene.p, scene["position"] - scene.p["q_0"]
        return Contribution(term=-p["k_3"] * deflection**3 - p["k_2"] * deflection**2)

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        position = conditions.variables["position"]
        size = 0.1 * conditions.magnitude / (0.5 * conditions.span("position")) ** 3
        middle = 0.5 * float(position.min() + position.max())
        return [{"k_3": size, "k_2": 0.0, "q_0": 0.0}, {"k_3": size, "k_2": 0.0, "q_0": middle}]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example()]
