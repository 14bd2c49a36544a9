"""Effects of heat balances."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import (
    Array,
    Conditions,
    Contribution,
    Effect,
    Parameter,
    Scene,
    Site,
    product,
)
from residuum.identification.physics.effects.example_models import Example, oven_example


class HeatLoss(Effect):
    """Base of the losses to the surroundings; the surroundings' temperature is the balance's
    `ambient`, else a parameter.
    """

    acts_on = ("heat",)
    needs = ("temperature",)

    def surroundings(self, site: Site) -> tuple[Parameter, ...]:
        """The parameter `T_a` where the balance names no ambient."""
        if "ambient" in site.units:
            return ()
        # A room's 20 °C, on the scale of the model.
        unit = site.units["temperature"]
        return (
            Parameter(
                "T_a",
                20.0 + 273.15 + absolute_zero(unit),
                unit,
                meaning="temperature of the surroundings",
            ),
        )

    def ambient(self, scene: Scene) -> sp.Expr:
        """Temperature of the surroundings."""
        return scene.variables["ambient"] if "ambient" in scene.variables else scene.p["T_a"]

    def first_ambient(self, conditions: Conditions) -> dict[str, float]:
        """The lowest temperature on record as a first `T_a`, where there is such a parameter."""
        if "ambient" in conditions.variables:
            return {}
        return {"T_a": float(np.min(conditions.variables["temperature"]))}

    def examples(self) -> list[Example]:
        return [oven_example()]


def absolute_zero(unit: str) -> float:
    """Absolute zero on the scale of a temperature unit.

    >>> absolute_zero("°C"), absolute_zero("K")
    (-273.15, 0.0)
    """
    return -273.15 if unit.strip() in ("°C", "degC", "C") else 0.0


class AmbientLoss(HeatLoss):
    """Conduction and convection: −h·(T − T_a).

    `h` [balance unit / K] ≥ 0; `T_a` [temperature unit] only where the balance names no ambient.
    """

    id = "ambient-loss"
    title = "Loss to the surroundings"
    equation = "−h·(T − T_a)"
    reference = "Newton 1701"
    sizes = ("h",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter(
                "h",
                0.0,
                site.per("temperature"),
                lower=0.0,
                meaning="loss per temperature difference",
            ),
            *self.surroundings(site),
        )

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(term=-scene.p["h"] * (scene["temperature"] - self.ambient(scene)))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [
            {
                "h": 0.1 * conditions.magnitude / conditions.span("temperature"),
                **self.first_ambient(conditions),
            }
        ]


class ConstantHeat(Effect):
    """+q_0: electronics beside the sensor, a neighbour, the sun.

    `q_0` [balance unit], either sign.
    """

    id = "constant-heat"
    title = "Constant heat"
    equation = "+q_0"
    reference = "F. P. Incropera, D. P. DeWitt, Fundamentals of Heat and Mass Transfer, ch. 1"
    acts_on = ("heat",)
    sizes = ("q_0",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("q_0", 0.0, site.unit, meaning="heat that is always there"),)

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(term=scene.p["q_0"])

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"q_0": 0.1 * conditions.magnitude}]

    def examples(self) -> list[Example]:
        return [oven_example()]


class Radiation(HeatLoss):
    """−c·(T⁴ − T_a⁴) with absolute temperatures.

    `c` [balance unit / K⁴] ≥ 0 (emissivity · area · Stefan–Boltzmann constant); `T_a` as in the
    ambient loss.
    """

    id = "radiation"
    title = "Radiation"
    equation = "−c·(T⁴ − T_a⁴)"
    reference = "Stefan 1879, Boltzmann 1884"
    sizes = ("c",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter(
                "c",
                0.0,
                site.per("temperature", 4),
                lower=0.0,
                meaning="emissivity · area · Stefan–Boltzmann constant",
            ),
            *self.surroundings(site),
        )

    def contribution(self, scene: Scene) -> Contribution:
        # The fourth power is of absolute temperatures, on whatever scale the model has.
        zero = sp.Float(absolute_zero(scene.site.units["temperature"]))
        hot = scene["temperature"] - zero
        cold = self.ambient(scene) - zero
        return Contribution(term=-scene.p["c"] * (hot**4 - cold**4))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [
            {
                # Near room temperature T⁴ − T_a⁴ is 4·(300 K)³·ΔT: within a factor of four a tenth
                # of the heating.
                "c": 0.1 * conditions.magnitude / (300.0**3 * conditions.span("temperature")),
                **self.first_ambient(conditions),
            }
        ]


# Keeps the power's slope finite at ΔT = 0, where |ΔT|^n has none.
_LEAST = 1e-6


class Convection(HeatLoss):
    """−h·ΔT·(|ΔT|/10 K)^n, ΔT = T − T_a: air that rises the faster the hotter the wall (n = 0.25 to
    0.33).

    `h` [balance unit / K] ≥ 0, at a difference of 10 K; `n` [1], 0 … 1.5. With n = 0 it is the
    plain loss.
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
            Parameter(
                "h", 0.0, site.per("temperature"), lower=0.0, meaning="loss per difference, at 10 K"
            ),
            Parameter(
                "n", 0.25, "", lower=0.0, upper=1.5, meaning="exponent of the difference, less one"
            ),
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


class SecondHeatStore(Effect):
    """C_2·T_2' = G·(T − T_2) and −G·(T − T_2) in the balance.

    `C_2` [balance unit · s / K] > 0, `G` [balance unit / K] ≥ 0. T_2 begins at T, or where the
    record says.
    """

    id = "second-heat-store"
    title = "Second heat store"
    equation = "−G·(T − T_2), C_2·T_2' = G·(T − T_2)"
    reference = "VDI Heat Atlas, part E"
    acts_on = ("heat",)
    needs = ("temperature",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter(
                "C_2",
                1.0,
                product(site.per("temperature"), "s"),
                lower=1e-9,
                meaning="heat capacity of the second store",
            ),
            Parameter(
                "G",
                0.0,
                site.per("temperature"),
                lower=0.0,
                meaning="conductance between the stores",
            ),
        )

    def states(self, site: Site) -> Mapping[str, str]:
        return {"T_2": site.units["temperature"]}

    def contribution(self, scene: Scene) -> Contribution:
        flow = scene.p["G"] * (scene["temperature"] - scene.x["T_2"])
        return Contribution(
            term=-flow,
            rates={"T_2": flow / scene.p["C_2"]},
            initial={"T_2": scene["temperature"]},
            deviating=("T_2",),
        )

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        first_values = []
        # Stores that fill in a hundredth, a twentieth and a third of the record.
        for share, fraction in ((0.3, 0.01), (1.0, 0.05), (1.0, 0.3)):
            C_2 = share * conditions.storage
            first_values.append({"C_2": C_2, "G": C_2 / (fraction * conditions.duration)})
        return first_values

    def shows(self, values: Mapping[str, float], conditions: Conditions) -> bool:
        """Whether the second store fills within the record. One that does not is a loss to where
        its temperature began.
        """
        return values["C_2"] < values["G"] * conditions.duration

    def examples(self) -> list[Example]:
        return [oven_example()]


class ConveyorLoad(HeatLoss):
    """Cold goods enter and leave warm: −G·(T − T_a), times the conveyor signal where the model has
    an input `conveyor`.

    `G` [balance unit / K] ≥ 0 (mass flow · specific heat); `T_a` as in the ambient loss. Without a
    recorded conveyor signal it cannot be told from an ambient loss.
    """

    id = "conveyor-load"
    title = "Conveyor load"
    equation = "−G·(T − T_a)·conveyor"
    reference = "VDI Heat Atlas, part A"
    sizes = ("G",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter(
                "G",
                0.0,
                site.per("temperature"),
                lower=0.0,
                meaning="mass flow times specific heat",
            ),
            *self.surroundings(site),
        )

    def recorded(self, site: Site) -> bool:
        """Where there is a conveyor signal: else it is an ambient loss by another name."""
        return "conveyor" in site.units

    def contribution(self, scene: Scene) -> Contribution:
        running = scene.variables.get("conveyor", sp.S.One)
        return Contribution(
            term=-scene.p["G"] * (scene["temperature"] - self.ambient(scene)) * running
        )

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [
            {
                "G": 0.1 * conditions.magnitude / conditions.span("temperature"),
                **self.first_ambient(conditions),
            }
        ]


def lowest_stretch(signal: Array) -> tuple[int, int]:
    """Samples [begin, end) of the stretch where the signal stays furthest below its median (largest
    partial sum).
    """
    # The largest partial sum (as in a CUSUM): a quarter of a deviation is taken off, so that noise
    # alone adds up to nothing.
    below = np.median(signal) - signal
    below = below - 0.25 * np.std(below)
    total = np.concatenate([[0.0], np.cumsum(below)])
    before = np.minimum.accumulate(total)
    end = int(np.argmax(total - before))
    return int(np.argmin(total[: end + 1])), end


class DoorOpening(HeatLoss):
    """−G·(T − T_a) while open: by the input `door` where the model has one, else once, from t_open
    for t_length.

    `G` [balance unit / K] ≥ 0; `t_open`, `t_length` [s] since the record's start (edges of a
    twentieth of t_length); `T_a` as in the ambient loss. Without a door signal it describes a
    single record.
    """

    id = "door-opening"
    title = "Door opening"
    equation = "−G·(T − T_a)·open(t)"
    reference = "ASHRAE Handbook Refrigeration, ch. 24"
    sizes = ("G",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        times = (
            Parameter("t_open", 0.0, "s", lower=0.0, meaning="when it opens"),
            Parameter("t_length", 60.0, "s", lower=1e-3, meaning="how long it stays open"),
        )
        G = Parameter("G", 0.0, site.per("temperature"), lower=0.0, meaning="exchange while open")
        return (G, *(() if "door" in site.units else times), *self.surroundings(site))

    def recorded(self, site: Site) -> bool:
        """Where there is a door signal: else it is heat that was lost for a while, whoever took
        it.
        """
        return "door" in site.units

    def contribution(self, scene: Scene) -> Contribution:
        p = scene.p
        if "door" in scene.variables:
            opened = scene["door"]
        else:
            # Smooth edges: the times of opening can be estimated by slopes.
            edge = p["t_length"] / 20
            begin = (scene.t - p["t_open"]) / edge
            end = (scene.t - p["t_open"] - p["t_length"]) / edge
            opened = (sp.tanh(begin) - sp.tanh(end)) / 2
        return Contribution(term=-p["G"] * (scene["temperature"] - self.ambient(scene)) * opened)

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        base = {
            "G": 0.3 * conditions.magnitude / conditions.span("temperature"),
            **self.first_ambient(conditions),
        }
        if "door" in conditions.variables:
            return [base]
        if conditions.missing is not None:
            begin, end = lowest_stretch(conditions.missing)
            scale = conditions.duration / conditions.missing.size
            return [base | {"t_open": begin * scale, "t_length": max(end - begin, 1) * scale}]
        # Nothing shows where: five openings of a tenth of the record, along it.
        length = 0.1 * conditions.duration
        return [base | {"t_open": k * length, "t_length": length} for k in range(0, 10, 2)]
