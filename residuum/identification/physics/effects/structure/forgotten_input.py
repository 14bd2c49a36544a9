"""A recorded signal that acts on a balance, and that the model does not know."""

from __future__ import annotations

from residuum.identification.physics.effects.base import (
    Conditions,
    Contribution,
    Effect,
    Example,
    Parameter,
    Scene,
    Site,
    quotient,
)
from residuum.identification.physics.effects.example_models import tank_example


class ForgottenInput(Effect):
    """g·s, s a signal of the record: a flow into the next tank, a load that somebody measured, the neighbour's heat.

    It stands at `balance(signal)`. `gain` g [balance unit / signal unit], −1 where the signal is the flow that leaves.
    """

    id = "forgotten-input"
    title = "Forgotten input"
    equation = "g·s"
    reference = "M. C. Kennedy, A. O'Hagan, J. R. Stat. Soc. B 63 (2001) 425"
    acts_on = ("torque", "force", "voltage", "heat", "volume", "signal")
    sizes = ("gain",)
    signals = 1
    takes_columns = True

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        unit = quotient(site.unit, site.units[site.signals[0]]) if site.signals else ""
        return (Parameter("gain", 0.0, unit, meaning="of the signal in the balance"),)

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(term=scene.p["gain"] * scene[scene.site.signals[0]])

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        size = 0.1 * conditions.magnitude / conditions.largest(list(conditions.variables)[-1])
        return [{"gain": size}, {"gain": -size}]

    def examples(self) -> list[Example]:
        return [tank_example()]
