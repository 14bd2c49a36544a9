"""A ripple over the travel with a harmonic."""

from collections.abc import Mapping

import numpy as np

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import Conditions, Contribution, Parameter, Scene, Site
from residuum.identification.physics.effects.load.tooth_ripple import ToothRipple


class Cogging(ToothRipple):
    """−(a·sin nq + b·cos nq + a₂·sin 2nq + b₂·cos 2nq): magnets over iron, whose ripple is no sine.

    Amplitudes [balance unit]; `n` [rad / position unit] > 0. A tooth ripple has the first wave alone.
    """

    id = "cogging"
    title = "Cogging"
    equation = "−Σ (aₖ·sin knq + bₖ·cos knq), k = 1, 2"
    reference = "D. C. Hanselman, Brushless Permanent Magnet Motor Design, ch. 10"
    sizes = ("a", "b", "a2", "b2")
    generalises = "tooth-ripple"

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        first, second, wave = super().parameters(site)
        more = [Parameter(name, 0.0, site.unit, meaning="amplitude of the harmonic") for name in ("a2", "b2")]
        return (first, second, *more, wave)

    def contribution(self, scene: Scene) -> Contribution:
        p, angle = scene.p, scene.p["n"] * scene["position"]
        harmonic = p["a2"] * sp.sin(2 * angle) + p["b2"] * sp.cos(2 * angle)
        return Contribution(term=-(p["a"] * sp.sin(angle) + p["b"] * sp.cos(angle) + harmonic))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [start | {"a2": 0.3 * start["a"], "b2": 0.3 * start["b"]} for start in super().starts(conditions)]

    def grown(self, special: Mapping[str, float], conditions: Conditions) -> list[dict[str, float]]:
        """The same wave with a small harmonic."""
        size = 0.1 * float(np.hypot(special["a"], special["b"]))
        return [dict(special) | {"a2": size, "b2": size}]

    def specialised(self, general: Mapping[str, float], conditions: Conditions) -> dict[str, float]:
        """The first wave."""
        return {name: general[name] for name in ("a", "b", "n")}

    def says_more(self, general: Mapping[str, float], std: Mapping[str, float]) -> bool:
        """Not without a harmonic."""
        return any(abs(general[name]) > 2.0 * std[name] for name in ("a2", "b2"))
