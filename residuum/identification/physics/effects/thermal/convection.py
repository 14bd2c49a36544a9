"""Natural convection."""

from collections.abc import Mapping

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import Conditions, Contribution, Parameter, Scene, Site
from residuum.identification.physics.effects.thermal.heat_loss import HeatLoss

_LEAST = 1e-6


class Convection(HeatLoss):
    """−h·ΔT·(|ΔT|/10 K)^n, ΔT = T − T_a: air that rises the faster the hotter the wall (n = 0.25 to 0.33).

    `h` [balance unit / K] ≥ 0, at a difference of 10 K; `n` [1], 0 … 1.5. With n = 0 it is the plain loss.
    """

    id = "convection"
    title = "Natural convection"
    equation = "−h·ΔT·(|ΔT|/10 K)^n"
    reference = "S. W. Churchill, H. H. S. Chu, Int. J. Heat Mass Transfer 18 (1975) 1323"
    sizes = ("h",)
    generalises = "ambient-loss"
    natural_bounds = ("n",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("h", 0.0, site.per("temperature"), lower=0.0, meaning="loss per difference, at 10 K"),
            Parameter("n", 0.25, "", lower=0.0, upper=1.5, meaning="exponent of the difference, less one"),
            *self.surroundings(site),
        )

    def contribution(self, scene: Scene) -> Contribution:
        difference = scene["temperature"] - self.ambient(scene)
        rise = (sp.Abs(difference) / 10 + sp.Float(_LEAST)) ** scene.p["n"]
        return Contribution(term=-scene.p["h"] * difference * rise)

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        size = 0.1 * conditions.magnitude / conditions.span("temperature")
        return [{"h": size, "n": 0.25, **self.first_ambient(conditions)}]

    def specialised(self, general: Mapping[str, float], conditions: Conditions) -> dict[str, float]:
        """The plain loss at the same coefficient."""
        return {name: value for name, value in general.items() if name != "n"}

    def says_more(self, general: Mapping[str, float], std: Mapping[str, float]) -> bool:
        """Not without an exponent."""
        return general["n"] > 2.0 * std["n"]
