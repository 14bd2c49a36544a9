"""What an actuator makes of its command: effects on the path of an input, and gains of a balance's
supply that change with it.
"""

from collections.abc import Mapping

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import (
    Conditions,
    Contribution,
    Effect,
    Parameter,
    Scene,
    Site,
)
from residuum.identification.physics.effects.example_models import (
    Example,
    axis_example,
    drive_example,
    oven_example,
    tank_example,
)


class InputDelay(Effect):
    """u(t − T_d), interpolated between samples.

    `delay` [s] ≥ 0.
    """

    id = "input-delay"
    title = "Input delay"
    equation = "u(t − T_d)"
    reference = "O. J. M. Smith, Chem. Eng. Progress 53 (1957) 217"
    acts_on = ("input",)
    shifts = "delay"
    sizes = ("delay",)
    generalises = "input-delay"

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("delay", 0.0, "s", lower=0.0, meaning="delay"),)

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(delay=scene.p["delay"])

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        # Within a sample, some samples, and many: delays have a minimum between each two samples of
        # a fast input.
        return [{"delay": steps * conditions.sample_time} for steps in (0.5, 3.0, 12.0)]

    def grown(self, special: Mapping[str, float], conditions: Conditions) -> list[dict[str, float]]:
        """Half a sample to either side: between two samples of a fast input lies a small summit."""
        moves = [part * conditions.sample_time for part in (-0.5, 0.5)]
        return [
            {"delay": special["delay"] + move} for move in moves if special["delay"] + move > 0.0
        ]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example(), oven_example(), tank_example()]


class InputLag(Effect):
    """First-order lag: τ·u_f' = u − u_f, begun at u or where the record says: amplifiers, valves,
    propellers that spin up.

    `tau` [s] > 0.
    """

    id = "input-lag"
    title = "Input lag"
    equation = "τ·u_f' = u − u_f"
    reference = (
        "G. F. Franklin, J. D. Powell, A. Emami-Naeini, Feedback Control of Dynamic Systems, ch. 2"
    )
    acts_on = ("input",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("tau", 1e-3, "s", lower=1e-9, meaning="time constant of the actuator"),)

    def states(self, site: Site) -> Mapping[str, str]:
        return {"u_f": site.unit}

    def contribution(self, scene: Scene) -> Contribution:
        u = scene.signal
        lagged = scene.x["u_f"]
        return Contribution(
            signal=lagged,
            rates={"u_f": (u - lagged) / scene.p["tau"]},
            initial={"u_f": u},
            deviating=("u_f",),
        )

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"tau": steps * conditions.sample_time} for steps in (1.0, 5.0, 25.0)]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example(), oven_example(), tank_example()]


class InputDeadZone(Effect):
    """u − δ above δ, u + δ below −δ, nothing between.

    `delta` [input unit] ≥ 0.
    """

    id = "input-dead-zone"
    title = "Input dead zone"
    equation = "dead zone of ±δ"
    reference = (
        "G. Tao, P. V. Kokotović, Adaptive Control of Systems with Actuator and Sensor"
        " Nonlinearities, Wiley 1996"
    )
    acts_on = ("input",)
    sizes = ("delta",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("delta", 0.0, site.unit, lower=0.0, meaning="half width of the dead zone"),
        )

    def contribution(self, scene: Scene) -> Contribution:
        u = scene.signal
        delta = scene.p["delta"]
        return Contribution(
            signal=sp.Piecewise((u - delta, u > delta), (u + delta, u < -delta), (0, True))
        )

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        # A twentieth of the largest command.
        return [{"delta": 0.05 * conditions.largest("signal")}]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example(), oven_example(), tank_example()]


# Keeps |u|^e finite at u = 0, where a negative exponent has no value.
_LEAST = 1e-9


class InputPower(Effect):
    """u·(|u|/u_0)^e: a propeller's thrust goes with the square of its command (e = 1), a heater's
    power with that of its voltage.

    `e` [1], −0.9 … 3, the exponent less one; `u_0` [input unit], fixed at its RMS, where nothing
    changes.
    """

    id = "input-power"
    title = "Power law of an input"
    equation = "u·(|u|/u_0)^e"
    reference = (
        "T. I. Fossen, Handbook of Marine Craft Hydrodynamics and Motion Control, ch. 9 (propeller"
        " thrust)"
    )
    acts_on = ("input",)
    sizes = ("e",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("e", 0.0, "", lower=-0.9, upper=3.0, meaning="exponent less one"),
            Parameter(
                "u_0", 1.0, site.unit, lower=1e-12, fixed=True, meaning="input that stays as it is"
            ),
        )

    def contribution(self, scene: Scene) -> Contribution:
        u = scene.signal
        return Contribution(
            signal=u * (sp.Abs(u) / scene.p["u_0"] + sp.Float(_LEAST)) ** scene.p["e"]
        )

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        # Towards a square, and towards a root.
        return [{"e": e, "u_0": conditions.magnitude} for e in (0.5, -0.3)]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example(), oven_example(), tank_example()]


class InputSaturation(Effect):
    """u limited to ±u_max.

    `u_max` [input unit] > 0.
    """

    id = "input-saturation"
    title = "Input saturation"
    equation = "limit to ±u_max"
    reference = "J. C. Doyle et al., ACC 1987, 1015"
    acts_on = ("input",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("u_max", 1e9, site.unit, lower=1e-12, meaning="largest input"),)

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(
            signal=sp.Min(sp.Max(scene.signal, -scene.p["u_max"]), scene.p["u_max"])
        )

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        # Below the largest command: above it nothing is cut, and no slope leads there.
        return [{"u_max": fraction * conditions.largest("signal")} for fraction in (0.95, 0.8, 0.6)]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example(), oven_example(), tank_example()]


class InputBacklash(Effect):
    """Play: u_b follows u once it is more than w behind; τ·u_b' = dead zone of ±w of (u − u_b), τ
    short.

    `w` [input unit] > 0, half the play; `tau` [s], fixed at some samples: linkages, valve stems,
    gear racks.
    """

    id = "input-backlash"
    title = "Play of an input"
    equation = "τ·u_b' = dead zone of ±w of (u − u_b)"
    reference = (
        "G. Tao, P. V. Kokotović, Adaptive Control of Systems with Actuator and Sensor"
        " Nonlinearities, Wiley 1996"
    )
    acts_on = ("input",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("w", 1e-9, site.unit, lower=1e-12, meaning="half the play"),
            Parameter(
                "tau", 1e-3, "s", lower=1e-9, fixed=True, meaning="time in which it is taken up"
            ),
        )

    def states(self, site: Site) -> Mapping[str, str]:
        return {"u_b": site.unit}

    def contribution(self, scene: Scene) -> Contribution:
        u = scene.signal
        behind = scene.x["u_b"]
        w = scene.p["w"]
        away = u - behind
        pulled = sp.Piecewise((away - w, away > w), (away + w, away < -w), (0, True))
        return Contribution(
            signal=behind, rates={"u_b": pulled / scene.p["tau"]}, initial={"u_b": u}
        )

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [
            # Taken up within two samples, as good as at once.
            {"w": part * conditions.largest("signal"), "tau": 2.0 * conditions.sample_time}
            for part in (0.03, 0.15)
        ]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example(), oven_example(), tank_example()]


class InputOffset(Effect):
    """u + u_0.

    `u_0` [input unit].
    """

    id = "input-offset"
    title = "Input offset"
    equation = "u + u_0"
    reference = "JCGM 200:2012, 4.20"
    acts_on = ("input",)
    sizes = ("u_0",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("u_0", 0.0, site.unit, meaning="offset"),)

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(signal=scene.signal + scene.p["u_0"])

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"u_0": 0.05 * conditions.largest("signal")}]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example(), oven_example(), tank_example()]


_SMALLEST = 1e-6
"""Least share of the full input at which the power law is still followed: at zero it has no
derivative.
"""


class SupplyNonlinearity(Effect):
    """The supply's gain changes with the input u: supply·((1 + b·w)·w^γ − 1) with w = |u|/u_ref.

    γ follows power laws (lamps, phase control), b a gain that falls or rises evenly (saturating
    heaters, slipping pumps). `b`, `gamma` [1]; `u_ref` [input unit] fixed, where w is 1.
    """

    equation = "supply·((1 + b·w)·w^γ − 1), w = |u|/u_ref"
    needs = ("supply",)
    sizes = ("b", "gamma")

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("b", 0.0, "", meaning="change of the gain over the input's range"),
            Parameter(
                "gamma",
                0.0,
                "",
                lower=-0.9,
                upper=5.0,
                meaning="exponent of the power law beyond 1",
            ),
            Parameter(
                "u_ref",
                1.0,
                site.units["supply"],
                lower=1e-12,
                fixed=True,
                meaning="input at which w is 1",
            ),
        )

    def contribution(self, scene: Scene) -> Contribution:
        p = scene.p
        w = sp.Max(sp.Abs(scene["supply"]) / scene.p["u_ref"], sp.Float(_SMALLEST))
        return Contribution(
            term=scene["supply_terms"] * ((1 + p["b"] * w) * sp.exp(p["gamma"] * sp.log(w)) - 1)
        )

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"b": 0.1, "gamma": 0.1, "u_ref": conditions.largest("supply")}]


class HeaterNonlinearity(SupplyNonlinearity):
    """Power that follows a power law of the input (P ∝ u², lamps) or saturates; equation and
    parameters as in its base.
    """

    id = "heater-nonlinearity"
    title = "Heater nonlinearity"
    reference = "D. C. Agrawal, Eur. J. Phys. 32 (2011) 1 (lamp power law)"
    acts_on = ("heat",)

    def examples(self) -> list[Example]:
        return [oven_example()]


class PumpNonlinearity(SupplyNonlinearity):
    """Flow that falls behind the input (slip, pipe losses) or follows a power law; equation and
    parameters as in its base.
    """

    id = "pump-nonlinearity"
    title = "Pump nonlinearity"
    reference = "J. F. Gülich, Centrifugal Pumps, Springer, ch. 4"
    acts_on = ("volume",)

    def examples(self) -> list[Example]:
        return [tank_example()]
