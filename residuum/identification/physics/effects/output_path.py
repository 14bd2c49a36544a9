"""Effects on the path of an output: what a sensor makes of its quantity."""

from collections.abc import Mapping

import numpy as np

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import (
    Conditions,
    Contribution,
    Effect,
    Parameter,
    Scene,
    Site,
    quotient,
)
from residuum.identification.physics.effects.example_models import (
    Example,
    axis_example,
    drive_example,
    oven_example,
    tank_example,
)


class OutputLag(Effect):
    """First-order lag: τ·y_f' = y − y_f, begun at y or where the record says.

    `tau` [s] > 0.
    """

    id = "output-lag"
    title = "Output lag"
    equation = "τ·y_f' = y − y_f"
    reference = "J. Fraden, Handbook of Modern Sensors, ch. 3"
    acts_on = ("output",)
    shifts = "tau"

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("tau", 1e-3, "s", lower=1e-9, meaning="time constant of the sensor"),)

    def states(self, site: Site) -> Mapping[str, str]:
        return {"y_f": site.unit}

    def contribution(self, scene: Scene) -> Contribution:
        y = scene.signal
        lagged = scene.x["y_f"]
        return Contribution(
            signal=lagged,
            rates={"y_f": (y - lagged) / scene.p["tau"]},
            initial={"y_f": y},
            deviating=("y_f",),
        )

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        # Time constants from below a sample to many samples, five times each.
        return [{"tau": steps * conditions.sample_time} for steps in (0.2, 1.0, 5.0, 25.0)]

    def shows(self, values: Mapping[str, float], conditions: Conditions) -> bool:
        """Whether the sensor comes near what it measures within the record. One that begins
        anywhere and hardly moves would make a load of what it measures, and friction of a speed.
        """
        return 2.0 * values["tau"] < conditions.duration

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example(), oven_example(), tank_example()]


class OutputDrift(Effect):
    """y + r·t, t the time since the record's start.

    `r` [output unit / s], either sign.
    """

    id = "output-drift"
    title = "Drift of a sensor"
    equation = "y + r·t"
    reference = "J. Fraden, Handbook of Modern Sensors, ch. 3 (drift)"
    acts_on = ("output",)
    sizes = ("r",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("r", 0.0, quotient(site.unit, "s"), meaning="drift a second"),)

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(signal=scene.signal + scene.p["r"] * scene.t)

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"r": 0.1 * conditions.magnitude / conditions.duration}]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example(), oven_example(), tank_example()]


class OutputOffset(Effect):
    """y + y_0.

    `y_0` [output unit].
    """

    id = "output-offset"
    title = "Output offset"
    equation = "y + y_0"
    reference = "JCGM 200:2012, 4.20"
    acts_on = ("output",)
    sizes = ("y_0",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("y_0", 0.0, site.unit, meaning="offset"),)

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(signal=scene.signal + scene.p["y_0"])

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"y_0": 0.05 * conditions.largest("signal")}]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example(), oven_example(), tank_example()]


class OutputSaturation(Effect):
    """y limited to at most y_max.

    `y_max` [output unit], the largest reading.
    """

    id = "output-saturation"
    title = "End of the sensor's range"
    equation = "min(y, y_max)"
    reference = "J. Fraden, Handbook of Modern Sensors, ch. 3"
    acts_on = ("output",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("y_max", 1e9, site.unit, meaning="largest reading"),)

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(signal=sp.Min(scene.signal, scene.p["y_max"]))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        highest = float(conditions.variables["signal"].max())
        # Below the highest value: above it nothing is cut.
        return [{"y_max": highest - part * conditions.span("signal")} for part in (0.05, 0.2)]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example(), oven_example(), tank_example()]


class OutputAbsolute(Effect):
    """y + a·(|y| − y): with a = 1 only the magnitude is recorded.

    `a` [1], 0 … 1.
    """

    id = "output-absolute"
    title = "Magnitude only"
    equation = "y + a·(|y| − y)"
    reference = "J. Fraden, Handbook of Modern Sensors, ch. 8"
    acts_on = ("output",)
    sizes = ("a",)
    rest = 0.001
    natural_bounds = ("a",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("a", 0.0, "", lower=0.0, upper=1.0, meaning="share of the magnitude"),)

    def contribution(self, scene: Scene) -> Contribution:
        y = scene.signal
        return Contribution(signal=y + scene.p["a"] * (sp.Abs(y) - y))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"a": 1.0}]

    def examples(self) -> list[Example]:
        return [drive_example()]


class OutputGainCurve(Effect):
    """y·(1 + c·y/y_0): a reading that bends.

    `c` [1], −0.9 … 0.9, the gain's relative change at y_0; `y_0` [output unit], fixed at a large
    reading.
    """

    id = "output-gain-curve"
    title = "Bent gain of a sensor"
    equation = "y·(1 + c·y/y_0)"
    reference = "J. Fraden, Handbook of Modern Sensors, ch. 3 (nonlinearity)"
    acts_on = ("output",)
    sizes = ("c",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("c", 0.0, "", lower=-0.9, upper=0.9, meaning="change of the gain at y_0"),
            Parameter(
                "y_0",
                1.0,
                site.unit,
                lower=1e-12,
                fixed=True,
                meaning="reading at which it is told",
            ),
        )

    def contribution(self, scene: Scene) -> Contribution:
        y = scene.signal
        return Contribution(signal=y * (1 + scene.p["c"] * y / scene.p["y_0"]))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"c": 0.1, "y_0": conditions.largest("signal")}]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example(), oven_example(), tank_example()]


class OutputQuantisation(Effect):
    """q·round(y/q). Derivatives lean on the line through the stairs.

    `q` [output unit] > 0 is read off the record, whose samples lie on the stairs, and held: as a
    function of q the error has a minimum for every number of steps that a signal may be long. It
    only improves a model whose error is below a step.
    """

    id = "output-quantisation"
    title = "Output quantisation"
    equation = "q·round(y/q)"
    reference = "B. Widrow, I. Kollár, Quantization Noise, Cambridge 2008"
    acts_on = ("output",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("q", 1e-9, site.unit, lower=1e-12, fixed=True, meaning="step"),)

    def contribution(self, scene: Scene) -> Contribution:
        # its class needs SymPy
        from residuum.identification.physics.compile.equation_functions import (  # noqa: PLC0415
            SteppedRound,
        )

        q = scene.p["q"]
        return Contribution(signal=q * SteppedRound(scene.signal / q))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        measured = conditions.variables.get("measured")
        steps = np.abs(np.diff(measured)) if measured is not None else np.zeros(0)
        # Rounding of a file leaves differences that are no steps.
        steps = steps[np.isfinite(steps) & (steps > 1e-9 * conditions.largest("signal"))]
        return [{"q": float(np.min(steps)) if steps.size else 0.01 * conditions.magnitude}]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example(), oven_example(), tank_example()]
