"""What play and an elastic transmission share: part of the inertia is driven through a contact."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping

import numpy as np

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import Conditions, Contribution, Effect, Example, Scene, Site, product
from residuum.identification.physics.effects.example_models import axis_example, drive_example


class TwoBodies(Effect):
    """A share r of the inertia J has a velocity w of its own and is driven through what the twist φ transmits. φ' = v − w and
    r·J·w' = transmitted. The drive side keeps (1 − r)·J and feels −transmitted.

    A record, or a window of one, may begin while the contact is twisted or the far body still swings: where is estimated.
    """

    acts_on = ("torque", "force")
    needs = ("velocity",)

    def states(self, site: Site) -> Mapping[str, str]:
        return {"twist": product(site.units["velocity"], "s"), "far_velocity": site.units["velocity"]}

    @abstractmethod
    def transmitted(self, p: Mapping[str, sp.Expr], twist: sp.Expr, slip: sp.Expr) -> sp.Expr:
        """What the contact transmits at this twist and velocity difference."""

    def contribution(self, scene: Scene) -> Contribution:
        p, v, twist, w = scene.p, scene["velocity"], scene.x["twist"], scene.x["far_velocity"]
        transmitted = self.transmitted(p, twist, v - w)
        return Contribution(
            term=-transmitted,
            rates={"twist": v - w, "far_velocity": transmitted / (p["share"] * scene["storage"])},
            initial={"twist": sp.S.Zero, "far_velocity": v},
            deviating=("twist", "far_velocity"),
            storage_factor=1 - p["share"],
        )

    def shows(self, values: Mapping[str, float], conditions: Conditions) -> bool:
        """Whether the bodies swing against each other once at least, or come to rest as fast. A far body that begins anywhere on
        a softer spring, or creeps back, is a load and its slope.
        """
        reduced = values["share"] * conditions.storage  # the storage is what stays on this side of the spring
        frequency = np.sqrt(values["k"] / reduced)
        ratio = max(1.0, values["d"] / (2.0 * np.sqrt(values["k"] * reduced)))
        return bool(frequency / (ratio + np.sqrt(ratio**2 - 1.0)) * conditions.duration > 2.0 * np.pi)

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example()]
