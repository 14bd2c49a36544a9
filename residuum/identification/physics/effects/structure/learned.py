"""A curve over one signal that stands for physics nobody has named yet."""

from __future__ import annotations

import numpy as np

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import Conditions, Contribution, Effect, Example, Parameter, Scene, Site
from residuum.identification.physics.effects.example_models import axis_example

KNOTS_OF_A_CURVE = 9


class Learned(Effect):
    """Σ vₖ·hatₖ(s): straight lines between the values vₖ [balance unit] at the knots aₖ [signal unit], level beyond the ends.

    It stands at `balance(signal)`. The knots are fixed, at even quantiles of the signal; the value at the knot in the middle is
    that of the balance's other terms (0), so that a constant is never learned twice.
    """

    id = "learned"
    title = "Learned curve"
    equation = "Σ vₖ·hatₖ(s)"
    reference = "C. de Boor, A Practical Guide to Splines, Springer 2001, ch. III"
    acts_on = ("torque", "force", "voltage", "heat", "volume", "signal")
    sizes = tuple(f"v{k}" for k in range(1, KNOTS_OF_A_CURVE + 1))
    signals = 1
    curve = True

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        unit = site.units[site.signals[0]] if site.signals else ""
        knots = [Parameter(f"a{k}", float(k), unit, fixed=True, meaning="knot") for k in range(1, KNOTS_OF_A_CURVE + 1)]
        return (*knots, *(Parameter(name, 0.0, site.unit, meaning="value at the knot") for name in self.sizes))

    def contribution(self, scene: Scene) -> Contribution:
        s = scene[scene.site.signals[0]]
        a, v = ([scene.p[f"{name}{k}"] for k in range(1, KNOTS_OF_A_CURVE + 1)] for name in "av")
        slopes = [(v[k + 1] - v[k]) / (a[k + 1] - a[k]) for k in range(KNOTS_OF_A_CURVE - 1)]
        lines = [(v[k] + slopes[k] * (s - a[k]), s < a[k + 1]) for k in range(KNOTS_OF_A_CURVE - 1)]
        return Contribution(term=sp.Piecewise((v[0], s < a[0]), *lines, (v[-1], True)))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        """Knots at even quantiles of the signal, kept apart; values that any regression may change."""
        signal = conditions.variables[list(conditions.variables)[-1]]
        least = 0.02 * float(np.ptp(signal)) or 1.0
        at = np.quantile(signal, np.linspace(0.005, 0.995, KNOTS_OF_A_CURVE))
        for k in range(1, KNOTS_OF_A_CURVE):
            at[k] = max(at[k], at[k - 1] + least)
        size = 0.1 * conditions.magnitude
        return [{f"a{k + 1}": float(at[k]) for k in range(KNOTS_OF_A_CURVE)} | dict.fromkeys(self.sizes, size)]

    def examples(self) -> list[Example]:
        return [axis_example()]
