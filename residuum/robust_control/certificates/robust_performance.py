"""Algorithm 3: the most demanding monotone performance weight that every plant of the uncertainty set meets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput
from residuum.nearest_names import known_names
from residuum.robust_control.loop import Loop, Weights
from residuum.robust_control.synthesis.controller_structure import ControllerStructure
from residuum.robust_control.synthesis.pareto import Point, bisected_front, preferred
from residuum.robust_control.synthesis.structured_synthesis import Synthesis, synthesise
from residuum.robust_control.weights.nominal_performance import Infeasible, refined
from residuum.robust_control.weights.performance_weight import MonotoneWeight

_WISHES = ("high-gain", "critical-frequency")


@dataclass(frozen=True)
class RobustAim:
    """Gains [dB] and frequencies [rad/s] between which W_S is sought: l_g, h_g in [h_min, h_max] and ω_c from ω_c,min on.

    `only` = "high-gain" or "critical-frequency" lets that wish alone choose the point of the front (Remark 2.7).

    Raises BadInput when h_min ≥ h_max, h_max ≥ 0, l_g ≤ 0 or ω_c,min ≤ 0.
    """

    low_gain_db: float = 120.0
    smallest_high_gain_db: float = -50.0
    largest_high_gain_db: float = -0.5
    lowest_critical_frequency: float = 1.0
    high_gains: int = 8
    critical_frequencies: int = 192
    only: str | None = None

    def __post_init__(self) -> None:
        if self.only not in (None, *_WISHES):
            raise BadInput(f"RobustAim, only: is {self.only!r}; {known_names(self.only, _WISHES, 'must be one of')}")
        ordered = self.smallest_high_gain_db < self.largest_high_gain_db < 0 < self.low_gain_db
        if not (ordered and self.lowest_critical_frequency > 0):
            raise BadInput("RobustAim: needs h_min < h_max < 0 dB < l_g and a positive lowest critical frequency")


@dataclass(frozen=True, eq=False)
class RobustDesign:
    """Result of Algorithm 3: Pareto front over (h_g [dB], ω_c [rad/s]), the chosen point and its weight."""

    front: tuple[Point[Synthesis], ...]
    chosen: Point[Synthesis]
    weight: MonotoneWeight
    aim: RobustAim


def design_for_robust_performance(
    loop: Loop, W_T: FloatArray, structure: ControllerStructure, aim: RobustAim, critical_frequency: float
) -> RobustDesign:
    """Solve (2.37): maximise ω_c and h_g subject to max_ω |W_S S| + |W_T T| < 1.

    The controller minimises that very sum (the source minimises the mixed-sensitivity norm and then checks the sum, which
    is never better).

    Raises
    ------
    Infeasible
        Not even the lowest critical frequency with the smallest high-frequency gain can be met.
    """
    if aim.lowest_critical_frequency >= critical_frequency:
        raise Infeasible(
            f"aim: lowest critical frequency {aim.lowest_critical_frequency:.4g} rad/s is not below that of the uncertainty, "
            f"{critical_frequency:.4g} rad/s"
        )
    gains = np.linspace(aim.smallest_high_gain_db, aim.largest_high_gain_db, aim.high_gains)
    frequencies = np.geomspace(aim.lowest_critical_frequency, critical_frequency, aim.critical_frequencies)
    tried: list[Synthesis] = []

    def meets(high_gain: float, frequency: float, warm: Synthesis | None) -> Synthesis | None:
        W_S = MonotoneWeight(aim.low_gain_db, high_gain, frequency).magnitude(loop.omega)
        weights = Weights(W_S, W_T, "1")
        starts = None if warm is None else [warm.rho]
        found = synthesise(loop, weights, structure, starts=starts, target=0.995)
        if warm is not None and found.certified >= 1.0:
            found = synthesise(loop, weights, structure, target=0.995)
        tried.append(found)
        return found if found.certified < 1.0 and found.stable else None

    front = bisected_front([float(h) for h in gains], [float(w) for w in frequencies], meets)
    if not front:
        least = tried[-1]
        raise Infeasible(
            f"aim: no controller {structure.name!r} gives robust performance; at best |W_S S| + |W_T T| is {least.certified:.4g} "
            f"at {least.worst_frequency:.4g} rad/s where less than 1 is needed"
        )
    ideal = (aim.largest_high_gain_db, critical_frequency)
    span = (aim.largest_high_gain_db - aim.smallest_high_gain_db, critical_frequency - aim.lowest_critical_frequency)
    chosen = preferred(front, ideal, span, None if aim.only is None else _WISHES.index(aim.only))
    weight = MonotoneWeight(aim.low_gain_db, chosen.first, chosen.second)
    return RobustDesign(tuple(front), refined(loop, Weights(weight.magnitude(loop.omega), W_T, "1"), chosen), weight, aim)
