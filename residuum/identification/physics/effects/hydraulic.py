"""Effects of liquid volumes."""

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import (
    Conditions,
    Contribution,
    Effect,
    JoiningEffect,
    Parameter,
    Scene,
    Site,
)
from residuum.identification.physics.effects.example_models import Example, tank_example


class Drain(Effect):
    """Base of the outflows."""

    acts_on = ("volume",)
    needs = ("level",)

    def examples(self) -> list[Example]:
        return [tank_example()]


class Outflow(Drain):
    """Torricelli's law: −c·√level.

    `c` [balance unit / √level unit] ≥ 0, the area times √(2g).
    """

    id = "outflow"
    title = "Free outflow"
    equation = "−c·√h"
    reference = "Torricelli 1644"
    sizes = ("c",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter(
                "c", 0.0, site.per("level", 0.5), lower=0.0, meaning="orifice area times √(2g)"
            ),
        )

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(term=-scene.p["c"] * sp.sqrt(sp.Max(scene["level"], sp.Float(1e-12))))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"c": 0.1 * conditions.magnitude / conditions.largest("level") ** 0.5}]


# [level unit] Around a difference of zero, where √ has no slope, the flow goes evenly.
_LEAST = 1e-4


class Orifice(Effect):
    """−c·sign(h − h_0)·√|h − h_0|, both ways: a pipe to a neighbour whose level h_0 stays, or that
    ends below the tank's zero.

    `c` [balance unit / √level unit] ≥ 0; `h_0` [level unit], the level beyond.
    """

    id = "orifice"
    title = "Orifice to a constant level"
    equation = "−c·sign(h − h_0)·√|h − h_0|"
    reference = "H. E. Merritt, Hydraulic Control Systems, Wiley 1967, ch. 3"
    acts_on = ("volume",)
    needs = ("level",)
    sizes = ("c",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter(
                "c", 0.0, site.per("level", 0.5), lower=0.0, meaning="orifice area times √(2g)"
            ),
            Parameter("h_0", 0.0, site.units["level"], meaning="level beyond the orifice"),
        )

    def contribution(self, scene: Scene) -> Contribution:
        difference = scene["level"] - scene.p["h_0"]
        return Contribution(
            term=-scene.p["c"] * difference / sp.sqrt(sp.Abs(difference) + sp.Float(_LEAST))
        )

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        size = 0.1 * conditions.magnitude / conditions.span("level") ** 0.5
        # A level beyond near the lowest one, in the middle, and below the tank: three ways that a
        # pipe may end.
        beyond = (
            conditions.quantile("level", 0.1),
            conditions.quantile("level", 0.5),
            -0.5 * conditions.span("level"),
        )
        return [{"c": size, "h_0": h} for h in beyond]

    def examples(self) -> list[Example]:
        return [tank_example()]


class Overflow(Drain, JoiningEffect):
    """Weir: −c·max(h − h_max, 0)^1.5, which runs away, or at `balance(other)` into another store.

    `c` [balance unit / level unit^1.5] ≥ 0; `h_max` [level unit], the rim; `share` ≥ 0 times what
    runs over reaches the other store (above one where that one is the narrower, and both levels are
    counted in their own units).
    """

    id = "overflow"
    title = "Overflow"
    equation = (
        "−c·max(h − h_max, 0)^1.5, and +share·c·max(h − h_max, 0)^1.5 in another store that it runs"
        " into"
    )
    reference = "Poleni 1717"
    sizes = ("c",)
    reaches = True

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        weir = (
            Parameter("c", 0.0, site.per("level", 1.5), lower=0.0, meaning="weir coefficient"),
            Parameter("h_max", 1.0, site.units["level"], meaning="height of the rim"),
        )
        if not site.signals:
            return weir
        return (
            *weir,
            Parameter(
                "share",
                1.0,
                "1",
                lower=0.0,
                meaning="what the other store rises by, per fall of this one",
            ),
        )

    def contribution(self, scene: Scene) -> Contribution:
        over = scene.p["c"] * sp.Max(scene["level"] - scene.p["h_max"], 0) ** sp.Rational(3, 2)
        if not scene.site.signals:
            return Contribution(term=-over)
        return Contribution(term=-over, elsewhere={scene.site.signals[0]: scene.p["share"] * over})

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        size = conditions.magnitude / (0.1 * conditions.span("level")) ** 1.5
        into = {"share": 1.0} if "other:level" in conditions.variables else {}
        return [
            {"c": size, "h_max": conditions.quantile("level", f), **into} for f in (0.6, 0.8, 0.95)
        ]


class CheckValve(Drain):
    """−c·max(h − h_0, 0): a valve that opens above the level h_0 and lets nothing back.

    `c` [balance unit / level unit] ≥ 0; `h_0` [level unit] ≥ 0.
    """

    id = "check-valve"
    title = "Check valve"
    equation = "−c·max(h − h_0, 0)"
    reference = "H. E. Merritt, Hydraulic Control Systems, Wiley 1967, ch. 5"
    sizes = ("c",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter(
                "c", 0.0, site.per("level"), lower=0.0, meaning="flow per level above the opening"
            ),
            Parameter(
                "h_0", 0.0, site.units["level"], lower=0.0, meaning="level at which it opens"
            ),
        )

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(term=-scene.p["c"] * sp.Max(scene["level"] - scene.p["h_0"], 0))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        size = 0.2 * conditions.magnitude / conditions.span("level")
        return [
            {"c": size, "h_0": max(conditions.quantile("level", part), 0.0)} for part in (0.3, 0.6)
        ]


class Leak(Drain):
    """Laminar leak through a narrow gap: −c·h.

    `c` [balance unit / level unit] ≥ 0.
    """

    id = "leak"
    title = "Leak"
    equation = "−c·h"
    reference = "Hagen 1839, Poiseuille 1840"
    sizes = ("c",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("c", 0.0, site.per("level"), lower=0.0, meaning="leak per level"),)

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(term=-scene.p["c"] * scene["level"])

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"c": 0.1 * conditions.magnitude / conditions.largest("level")}]
