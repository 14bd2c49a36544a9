"""The winding stores magnetic energy."""

from residuum.identification.physics.effects.base import (
    Conditions,
    Contribution,
    Effect,
    Example,
    Parameter,
    Scene,
    Site,
    product,
)
from residuum.identification.physics.effects.example_models import drive_example


class Inductance(Effect):
    """A voltage balance without storage receives L·di/dt: the current becomes a state with time constant L/R.

    `L` [balance unit · s / current unit] > 0. A time constant far below the sample time cannot be seen; near it, it resembles an
    input delay. The current begins where it would settle, or where the record says: a machine may be switched on with it.
    """

    id = "inductance"
    title = "Inductance"
    equation = "L·di/dt = Σ voltages"
    reference = "Faraday 1831"
    acts_on = ("voltage",)
    needs = ("current", "defined")

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("L", 1e-6, product(site.per("current"), "s"), lower=1e-12, meaning="inductance"),)

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(inductance=scene.p["L"])

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"L": steps * conditions.storage * conditions.sample_time} for steps in (0.2, 1.0, 5.0)]

    def examples(self) -> list[Example]:
        return [drive_example()]
