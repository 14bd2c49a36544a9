"""Play between drive and load."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import Conditions, Parameter, Site, product
from residuum.identification.physics.effects.transmission.two_bodies import TwoBodies

_CROSSINGS = (4.0, 12.0, 36.0)
"""Samples in which the drive side alone, pushed as it is on average, crosses the play."""
_SOFT = (10.0, 30.0)
"""Samples in which the machine at its fastest crosses a play whose contact gives way by half of it, pushed on average."""


class Backlash(TwoBodies):
    """A share r of the inertia is driven through a contact with play. Nothing is transmitted while |φ| < gap/2. Beyond it acts
    a stiff, damped contact, k·(φ ∓ gap/2) + d·(v − w).

    `gap` [position unit] ≥ 0, `k`, `d`, `share` as in the elastic transmission. Only motion that reverses, or torque that
    does, shows it.
    """

    id = "backlash"
    title = "Backlash"
    equation = "−contact(φ), φ' = v − w, r·J·w' = contact(φ)"
    reference = "M. Nordin, P.-O. Gutman, Automatica 38 (2002) 1633"
    generalises = "elastic-transmission"

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("gap", 0.0, product(site.units["velocity"], "s"), lower=0.0, meaning="play"),
            Parameter("k", 1.0, product(site.per("velocity"), "1/s"), lower=1e-12, meaning="contact stiffness"),
            Parameter("d", 0.0, site.per("velocity"), lower=0.0, meaning="contact damping"),
            Parameter("share", 0.5, "", lower=0.01, upper=0.99, meaning="share of the inertia beyond the play"),
        )

    def transmitted(self, p: Mapping[str, sp.Expr], twist: sp.Expr, slip: sp.Expr) -> sp.Expr:
        half, damping = p["gap"] / 2, p["d"] * slip
        return sp.Piecewise(
            (p["k"] * (twist - half) + damping, twist > half), (p["k"] * (twist + half) + damping, twist < -half), (0, True)
        )

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        found, travelled = [], conditions.largest("velocity") * conditions.sample_time
        crossed = 0.5 * conditions.magnitude / conditions.storage * conditions.sample_time**2
        omega = 0.4 * np.pi / conditions.sample_time / 4.0
        plays = [(2.0 * travelled, 0.5), (10.0 * travelled, 0.5), (50.0 * travelled, 0.3)]
        plays += [(samples**2 * crossed / 0.5, 0.5) for samples in _CROSSINGS]
        for gap, share in plays:
            k = omega**2 * share * (1.0 - share) * conditions.storage
            found.append({"gap": gap, "k": k, "d": 0.3 * k / omega, "share": share})
        for samples in _SOFT if travelled > 0.0 else ():
            gap = samples * travelled
            k = 2.0 * conditions.magnitude / gap
            found.append({"gap": gap, "k": k, "d": 0.5 * float(np.sqrt(k * conditions.storage)), "share": 0.5})
        return found

    def specialised(self, general: Mapping[str, float], conditions: Conditions) -> dict[str, float]:
        """The contact without play."""
        return {name: general[name] for name in ("k", "d", "share")}

    def says_more(self, general: Mapping[str, float], std: Mapping[str, float]) -> bool:
        """Not without play."""
        return general["gap"] > 2.0 * std["gap"]

    def grown(self, special: Mapping[str, float], conditions: Conditions) -> list[dict[str, float]]:
        """A spring that is soft because part of its travel is play."""
        travel = 2.0 * float(np.max(np.abs(conditions.variables["twist"])))
        found = []
        for share in (0.3, 0.8):
            stiffer = {"k": special["k"] / (1.0 - share), "d": special["d"], "share": special["share"]}
            found.append({"gap": share * travel, **stiffer})
        return found
