"""Frictions and drags."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import (
    Conditions,
    Contribution,
    Effect,
    Parameter,
    Scene,
    Site,
    product,
    quotient,
)
from residuum.identification.physics.effects.example_models import (
    Example,
    axis_example,
    drive_example,
)


class Friction(Effect):
    """Base of the frictions."""

    acts_on = ("torque", "force")
    needs: ClassVar[tuple[str, ...]] = ("velocity",)

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example()]


class ViscousFriction(Friction):
    """Lubricated contacts and bearings: −d·v.

    `d` [balance unit / velocity unit] ≥ 0.
    """

    id = "viscous-friction"
    title = "Viscous friction"
    equation = "−d·v"
    reference = "Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083"
    sizes = ("d",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("d", 0.0, site.per("velocity"), lower=0.0, meaning="friction per velocity"),
        )

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(term=-scene.p["d"] * scene["velocity"])

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        # A tenth of the driving torque at the largest speed.
        return [{"d": 0.1 * conditions.magnitude / conditions.largest("velocity")}]


class CoulombFriction(Friction):
    """Dry friction: −τ_c·sign(v), and at standstill whatever holds, up to ±τ_c.

    `tau_c` [balance unit] ≥ 0.
    """

    id = "coulomb-friction"
    title = "Coulomb friction"
    equation = "−τ_c·sign(v)"
    reference = (
        "Coulomb 1785; Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083"
    )
    sizes = ("tau_c",)
    rest = 0.001

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("tau_c", 0.0, site.unit, lower=0.0, meaning="friction while sliding"),)

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(term=-scene.p["tau_c"] * scene.direction)

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"tau_c": 0.1 * conditions.magnitude}]


class StribeckFriction(Friction):
    """Stribeck curve: −(τ_c + τ_s·exp(−(v/v_s)²))·sign(v); breakaway needs τ_c + τ_s, sliding τ_c.

    `tau_c`, `tau_s` [balance unit] ≥ 0; `v_s` [velocity unit] > 0, the velocity over which the
    extra friction fades. Where the record never passes slowly through v_s, `tau_s` and `v_s` trade
    off.
    """

    id = "stribeck-friction"
    title = "Stribeck friction"
    equation = "−(τ_c + τ_s·exp(−(v/v_s)²))·sign(v)"
    reference = (
        "Stribeck 1902; Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083"
    )
    sizes = ("tau_c", "tau_s")
    rest = 0.001
    generalises = "coulomb-friction"

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("tau_c", 0.0, site.unit, lower=0.0, meaning="friction while sliding"),
            Parameter("tau_s", 0.0, site.unit, lower=0.0, meaning="extra friction at breakaway"),
            Parameter(
                "v_s",
                0.1,
                site.units["velocity"],
                lower=1e-9,
                meaning="velocity over which it fades",
            ),
        )

    def contribution(self, scene: Scene) -> Contribution:
        p = scene.p
        fading = sp.exp(-((scene["velocity"] / p["v_s"]) ** 2))
        return Contribution(term=-(p["tau_c"] + p["tau_s"] * fading) * scene.direction)

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        # Friction that fades within a hundredth, a twentieth and a fifth of the largest speed.
        size = 0.1 * conditions.magnitude
        fastest = conditions.largest("velocity")
        return [
            {"tau_c": size, "tau_s": size, "v_s": fraction * fastest}
            for fraction in (0.01, 0.05, 0.2)
        ]

    def specialised(self, general: Mapping[str, float], conditions: Conditions) -> dict[str, float]:
        """The friction while sliding."""
        return {"tau_c": general["tau_c"]}

    def says_more(self, general: Mapping[str, float], std: Mapping[str, float]) -> bool:
        """Not without a rise at rest."""
        return general["tau_s"] > 2.0 * std["tau_s"]

    def grown(self, special: Mapping[str, float], conditions: Conditions) -> list[dict[str, float]]:
        """Dry friction that was too large at speed and too small at rest."""
        # Coulomb's friction fits the mean of the curve: less while sliding, and more at rest.
        tau = special["tau_c"]
        fastest = conditions.largest("velocity")
        return [
            {"tau_c": 0.8 * tau, "tau_s": 0.5 * tau, "v_s": fraction * fastest}
            for fraction in (0.02, 0.1)
        ]


class LuGre(Effect):
    """−F, F' = σ·(v − |v|·F/g(v)), g = τ_c + τ_s·exp(−(v/v_s)²): LuGre's model without its damping
    of the bristles.

    `tau_c`, `tau_s` [balance unit] ≥ 0; `v_s` [velocity unit] > 0; `sigma` [balance unit / position
    unit] > 0, the bristles' stiffness. With a stiff bristle it is Stribeck's friction.
    """

    id = "lugre"
    title = "LuGre friction"
    equation = "−F, F' = σ·(v − |v|·F/g(v))"
    reference = (
        "C. Canudas de Wit, H. Olsson, K. J. Åström, P. Lischinsky, IEEE Trans. Autom. Control 40"
        " (1995) 419"
    )
    acts_on = ("torque", "force")
    needs = ("velocity",)
    sizes = ("sigma",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        stiffness = quotient(site.unit, product(site.units["velocity"], "s"))
        return (
            Parameter("tau_c", 1e-6, site.unit, lower=1e-12, meaning="friction while sliding"),
            Parameter("tau_s", 0.0, site.unit, lower=0.0, meaning="extra friction at breakaway"),
            Parameter(
                "v_s",
                0.1,
                site.units["velocity"],
                lower=1e-9,
                meaning="velocity over which it fades",
            ),
            Parameter("sigma", 0.0, stiffness, lower=0.0, meaning="stiffness of the bristles"),
        )

    def states(self, site: Site) -> Mapping[str, str]:
        return {"F": site.unit}

    def contribution(self, scene: Scene) -> Contribution:
        p = scene.p
        v = scene["velocity"]
        force = scene.x["F"]
        g = p["tau_c"] + p["tau_s"] * sp.exp(-((v / p["v_s"]) ** 2))
        return Contribution(
            term=-force,
            rates={"F": p["sigma"] * (v - sp.Abs(v) * force / g)},
            initial={"F": sp.S.Zero},
        )

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        size = 0.1 * conditions.magnitude
        fastest = conditions.largest("velocity")
        # Bristles that give way over what 5 and 30 samples at the fastest cover.
        travelled = fastest * conditions.sample_time
        return [
            {
                "tau_c": size,
                "tau_s": 0.3 * size,
                "v_s": 0.1 * fastest,
                "sigma": size / (steps * travelled),
            }
            for steps in (5.0, 30.0)
        ]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example()]


class DirectionalFriction(Friction):
    """Forward −τ₊, backward +τ₋: seals, wipers, worm gears under load.

    `tau_plus`, `tau_minus` [balance unit] ≥ 0; a machine may rub in one direction alone.
    """

    id = "directional-friction"
    title = "Directional friction"
    equation = "−τ₊ for v > 0, +τ₋ for v < 0"
    reference = "Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083"
    sizes = ("tau_plus", "tau_minus")
    rest = 0.001
    generalises = "coulomb-friction"
    natural_bounds = ("tau_plus", "tau_minus")

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("tau_plus", 0.0, site.unit, lower=0.0, meaning="friction forwards"),
            Parameter("tau_minus", 0.0, site.unit, lower=0.0, meaning="friction backwards"),
        )

    def contribution(self, scene: Scene) -> Contribution:
        s = scene.direction
        # 1 for s = 1 and for s = −1 only: at rest (s = 0) neither acts.
        forwards = s * (s + 1) / 2
        backwards = s * (s - 1) / 2
        return Contribution(term=-scene.p["tau_plus"] * forwards + scene.p["tau_minus"] * backwards)

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        size = 0.1 * conditions.magnitude
        return [{"tau_plus": size, "tau_minus": 0.5 * size}]

    def specialised(self, general: Mapping[str, float], conditions: Conditions) -> dict[str, float]:
        """Their mean."""
        return {"tau_c": 0.5 * (general["tau_plus"] + general["tau_minus"])}

    def says_more(self, general: Mapping[str, float], std: Mapping[str, float]) -> bool:
        """Not where both sides are equal; it may where the data leave that open, as beside a spring
        at rest anywhere.
        """
        doubt = float(np.hypot(std["tau_plus"], std["tau_minus"]))
        return not abs(general["tau_plus"] - general["tau_minus"]) <= 2.0 * doubt < np.inf


class DirectionalViscous(Friction):
    """−d₊·v forwards, −d₋·v backwards: check valves in dampers, screws, wipers.

    `d_plus`, `d_minus` [balance unit / velocity unit] ≥ 0.
    """

    id = "directional-viscous"
    title = "Directional viscous friction"
    equation = "−d₊·v for v > 0, −d₋·v for v < 0"
    reference = (
        "A. Wahrburg et al., Motor-current-based estimation, IEEE Robot. Autom. Lett. 3 (2018) 775"
    )
    sizes = ("d_plus", "d_minus")
    generalises = "viscous-friction"
    natural_bounds = ("d_plus", "d_minus")

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter(
                "d_plus",
                0.0,
                site.per("velocity"),
                lower=0.0,
                meaning="friction per velocity forwards",
            ),
            Parameter(
                "d_minus",
                0.0,
                site.per("velocity"),
                lower=0.0,
                meaning="friction per velocity backwards",
            ),
        )

    def contribution(self, scene: Scene) -> Contribution:
        v = scene["velocity"]
        return Contribution(
            term=-scene.p["d_plus"] * sp.Max(v, 0) - scene.p["d_minus"] * sp.Min(v, 0)
        )

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        # Unequal from the start, as the general case is.
        size = 0.1 * conditions.magnitude / conditions.largest("velocity")
        return [{"d_plus": size, "d_minus": 0.5 * size}]

    def specialised(self, general: Mapping[str, float], conditions: Conditions) -> dict[str, float]:
        """Their mean."""
        return {"d": 0.5 * (general["d_plus"] + general["d_minus"])}

    def says_more(self, general: Mapping[str, float], std: Mapping[str, float]) -> bool:
        """Not where both sides are equal."""
        return (
            not abs(general["d_plus"] - general["d_minus"])
            <= 2.0 * float(np.hypot(std["d_plus"], std["d_minus"]))
            < np.inf
        )


class LoadFriction(Friction):
    """Worm gears and guideways: −μ·|drive|·sign(v), with the sum of the driving terms (motor
    torque, applied force).

    `mu` [1], 0 … 1.
    """

    id = "load-friction"
    title = "Load-dependent friction"
    equation = "−μ·|drive|·sign(v)"
    reference = "F. Pfeiffer, Mechanical System Dynamics, Springer 2008"
    sizes = ("mu",)
    rest = 0.001

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter(
                "mu", 0.0, "", lower=0.0, upper=1.0, meaning="friction per driving torque or force"
            ),
        )

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(term=-scene.p["mu"] * sp.Abs(scene["drive"]) * scene.direction)

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        # A tenth of what drives.
        return [{"mu": 0.1}]


class PlaceFriction(Friction):
    """−τ·exp(−((q − q_0)/w)²)·sign(v): a dent in a rail, a rubbing seal, a chip in a screw.

    `tau` [balance unit] ≥ 0; `q_0` [position unit], the place; `w` [position unit] > 0, its half
    width.
    """

    id = "place-friction"
    title = "Friction at one place"
    equation = "−τ·exp(−((q − q_0)/w)²)·sign(v)"
    reference = (
        "Armstrong-Hélouvry, Control of Machines with Friction, Kluwer 1991, ch. 5"
        " (position-dependent friction)"
    )
    needs = ("velocity", "position")
    sizes = ("tau",)
    rest = 0.001

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        # A balance whose position has no unit of its own: speed times seconds.
        length = site.units["position"] or product(site.units["velocity"], "s")
        return (
            Parameter("tau", 0.0, site.unit, lower=0.0, meaning="friction at the place"),
            Parameter("q_0", 0.0, length, meaning="the place"),
            Parameter("w", 1.0, length, lower=1e-9, meaning="half width of the place"),
        )

    def contribution(self, scene: Scene) -> Contribution:
        p = scene.p
        gaussian = sp.exp(-(((scene["position"] - p["q_0"]) / p["w"]) ** 2))
        return Contribution(term=-p["tau"] * gaussian * scene.direction)

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        size = 0.1 * conditions.magnitude
        travel = conditions.span("position")
        lowest = float(conditions.variables["position"].min())
        return [
            {"tau": size, "q_0": lowest + part * travel, "w": 0.12 * travel}
            # Places along the travel, the middle first.
            for part in (0.5, 0.2, 0.8, 0.35)
        ]


class QuadraticDrag(Friction):
    """Fans, fast carriages, stirrers: −c·v·|v|.

    `c` [balance unit / velocity unit²] ≥ 0.
    """

    id = "quadratic-drag"
    title = "Quadratic drag"
    equation = "−c·v·|v|"
    reference = "Rayleigh 1876"
    sizes = ("c",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter(
                "c", 0.0, site.per("velocity", 2), lower=0.0, meaning="drag per velocity squared"
            ),
        )

    def contribution(self, scene: Scene) -> Contribution:
        v = scene["velocity"]
        return Contribution(term=-scene.p["c"] * v * sp.Abs(v))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        # A tenth of the driving torque at the largest speed.
        return [{"c": 0.1 * conditions.magnitude / conditions.largest("velocity") ** 2}]
