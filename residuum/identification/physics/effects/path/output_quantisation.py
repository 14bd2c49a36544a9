"""The sensor counts in steps."""

import numpy as np

from residuum.identification.physics.effects.base import Conditions, Contribution, Effect, Example, Parameter, Scene, Site
from residuum.identification.physics.effects.example_models import axis_example, drive_example, oven_example, tank_example


class OutputQuantisation(Effect):
    """q·round(y/q). Derivatives lean on the line through the stairs.

    `q` [output unit] > 0 is read off the record, whose samples lie on the stairs, and held: as a function of q the error has a
    minimum for every number of steps that a signal may be long. It only improves a model whose error is below a step.
    """

    id = "output-quantisation"
    title = "Output quantisation"
    equation = "q·round(y/q)"
    reference = "B. Widrow, I. Kollár, Quantization Noise, Cambridge 2008"
    acts_on = ("output",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("q", 1e-9, site.unit, lower=1e-12, fixed=True, meaning="step"),)

    def contribution(self, scene: Scene) -> Contribution:
        from residuum.identification.physics.simulate.stepped_round import SteppedRound  # noqa: PLC0415  its class needs SymPy

        q = scene.p["q"]
        return Contribution(signal=q * SteppedRound(scene.signal / q))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        measured = conditions.variables.get("measured")
        steps = np.abs(np.diff(measured)) if measured is not None else np.zeros(0)
        steps = steps[np.isfinite(steps) & (steps > 1e-9 * conditions.largest("signal"))]
        return [{"q": float(np.min(steps)) if steps.size else 0.01 * conditions.magnitude}]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example(), oven_example(), tank_example()]
