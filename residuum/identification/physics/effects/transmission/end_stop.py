"""Elastic stops at the ends of the travel."""

from collections.abc import Mapping

import numpy as np

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import Array, Conditions, Contribution, Effect, Example, Parameter, Scene, Site
from residuum.identification.physics.effects.example_models import axis_example, drive_example

_DEPTHS = np.array([0.001, 0.005, 0.03])
"""Shares of the travel that may lie beyond a stop."""


def _bend(position: Array, force: Array) -> float:
    """Where, in the upper half of the travel, a force that falls evenly from there on explains most of the force.

    A machine that is at this end for more than half of the time has no upper half: then the end itself.
    """
    middle, end = float(np.median(position)), float(np.max(position))
    if middle == end:
        return end
    q = np.linspace(middle, end, 60, endpoint=False)
    beyond = [np.maximum(position - each, 0.0) for each in q]
    explained = [min(float(force @ b), 0.0) ** 2 / max(float(b @ b), 1e-300) for b in beyond]  # a travel of 1e-160 m squares to 0
    return float(q[int(np.argmax(explained))])


class EndStop(Effect):
    """Pushes back beyond either end, as a spring with a damper that never pulls. It adds −max(k·(q − q_max) + d·v, 0) above
    q_max,
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
    ordered = (("q_min", "q_max"),)
    follows = ("lack",)
    generalises = "end-stop"
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
        """One end at a time; how far the motion goes beyond it nobody knows, unless what is missing shows it."""
        q, span = conditions.variables["position"], conditions.span("position")
        low, high = float(np.min(q)), float(np.max(q))
        ends = [(high - depth, low - span) for depth in _DEPTHS * span] + [(high + span, low + depth) for depth in _DEPTHS * span]
        if conditions.missing is not None and np.any(conditions.missing):
            above, below = _bend(q, conditions.missing), _bend(-q, -conditions.missing)
            ends += [(above, low - span), (high + span, -below), (above, -below)]
        found = []
        for q_max, q_min in ends:
            if not q_min < q_max:  # both bends at the middle of the travel: a spring
                continue
            k = conditions.magnitude / max(high - q_max, q_min - low, 1e-6 * span)
            found.append({"k": k, "d": 2.0 * float(np.sqrt(k * conditions.storage)), "q_max": q_max, "q_min": q_min})
        return found

    def grown(self, special: Mapping[str, float], conditions: Conditions) -> list[dict[str, float]]:
        """The stops moved by parts of what the machine travels in a sample: each moment of contact is a small summit."""
        motion = float(np.quantile(np.abs(np.diff(conditions.variables["position"])), 0.9))
        moves = [part * motion for part in (-0.3, -0.05, 0.05, 0.3)]
        return [dict(special) | {n: special[n] + move for n in ("q_max", "q_min")} for move in moves]

    def shows(self, values: Mapping[str, float], conditions: Conditions) -> bool:
        """Whether the machine leaves a stop within the record: one that it always touches is a spring, a load and a damping."""
        q = conditions.variables["position"]
        return bool(np.any((q <= values["q_max"]) & (q >= values["q_min"])))

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example()]
