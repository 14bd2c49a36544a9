"""Dry friction that grows with the transmitted load."""

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import Conditions, Contribution, Parameter, Scene, Site
from residuum.identification.physics.effects.friction.friction import Friction


class LoadFriction(Friction):
    """Worm gears and guideways: −μ·|drive|·sign(v), with the sum of the driving terms (motor torque, applied force).

    `mu` [1], 0 … 1.
    """

    id = "load-friction"
    title = "Load-dependent friction"
    equation = "−μ·|drive|·sign(v)"
    reference = "F. Pfeiffer, Mechanical System Dynamics, Springer 2008"
    sizes = ("mu",)
    rest = 0.001

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("mu", 0.0, "", lower=0.0, upper=1.0, meaning="friction per driving torque or force"),)

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(term=-scene.p["mu"] * sp.Abs(scene["drive"]) * scene.direction)

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"mu": 0.1}]
