"""Constant voltage lost at the brushes."""

from residuum.identification.physics.effects.base import Conditions, Contribution, Effect, Example, Parameter, Scene, Site
from residuum.identification.physics.effects.example_models import drive_example


class BrushDrop(Effect):
    """−V_b·sign(i): no current flows until the drop is overcome.

    `V_b` [balance unit] ≥ 0. Through K·i it resembles Coulomb friction unless the current is recorded.
    """

    id = "brush-drop"
    title = "Brush voltage drop"
    equation = "−V_b·sign(i)"
    reference = "A. E. Fitzgerald et al., Electric Machinery, ch. 7"
    acts_on = ("voltage",)
    needs = ("current",)
    sizes = ("V_b",)
    rest = 0.001

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("V_b", 0.0, site.unit, lower=0.0, meaning="voltage drop of the brushes"),)

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(term=-scene.p["V_b"] * scene.direction)

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"V_b": 0.05 * conditions.magnitude}]

    def examples(self) -> list[Example]:
        return [drive_example()]
