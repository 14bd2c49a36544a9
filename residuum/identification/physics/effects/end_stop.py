"""Elastic stops at the ends of the travel."""

from collections.abc import Mapping

import numpy as np
import sympy as sp

from residuum.identification.physics.effects.base import Array, Conditions, Contribution, Effect, Example, Parameter, Scene, Site
from residuum.identification.physics.effects.example_models import axis_example, drive_example


class EndStop(Effect):
    """Pushes back beyond either end, as a spring with a damper that never pulls: −max(k·(q − q_max) + d·v, 0) above q_max,
    max(k·(q_min − q) − d·v, 0) below q_min.

    `k` [balance unit / position unit] ≥ 0, `d` [balance unit / velocity unit] ≥ 0; `q_max`, `q_min` [position unit].
    """

    id = "end-stop"
    title = "End stop"
    equation = "−max(k·(q − q_max) + d·v, 0) for q > q_max, max(k·(q_min − q) − d·v, 0) for q < q_min"
    reference = "W. J. Stronge, Impact Mechanics, Cambridge 2000 (Kelvin–Voigt contact)"
    acts_on = ("torque", "force")
    needs = ("position", "velocity")
    sizes = ("k", "d")
    natural_bounds = ("d",)
    rest = 0.001

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("k", 0.0, site.per("position"), lower=0.0, meaning="stiffness of the stop"),
            Parameter("d", 0.0, site.per("velocity"), lower=0.0, meaning="damping of the stop"),
            Parameter("q_max", 1.0, site.units["position"], meaning="upper end"),
            Parameter("q_min", -1.0, site.units["position"], meaning="lower end"),
        )

    def contribution(self, scene: Scene) -> Contribution:
        p, q, damped = scene.p, scene["position"], scene.p["d"] * scene["velocity"]
        above = sp.Piecewise((sp.Max(p["k"] * (q - p["q_max"]) + damped, 0), q > p["q_max"]), (0, True))
        below = sp.Piecewise((sp.Max(p["k"] * (p["q_min"] - q) - damped, 0), q < p["q_min"]), (0, True))
        return Contribution(term=below - above)

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        """One end at a time; how far the motion goes beyond it nobody knows."""
        q, span = conditions.variables["position"], conditions.span("position")
        low, high = float(np.min(q)), float(np.max(q))
        found = []
        for depth in (0.001 * span, 0.005 * span, 0.03 * span):
            k = conditions.magnitude / depth
            stop = {"k": k, "d": 2.0 * float(np.sqrt(k * conditions.storage))}
            found += [stop | {"q_max": high - depth, "q_min": low - span}, stop | {"q_max": high + span, "q_min": low + depth}]
        return found

    def obeys_physics(self, term: Array, variables: Mapping[str, Array], values: Mapping[str, float]) -> bool:
        """Pushes inwards beyond the ends, does nothing between them."""
        q = variables["position"]
        inwards = np.all(term[q > values["q_max"]] <= 0.0) and np.all(term[q < values["q_min"]] >= 0.0)
        return bool(inwards and np.all(term[(q < values["q_max"]) & (q > values["q_min"])] == 0.0))

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example()]
