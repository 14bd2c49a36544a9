"""A controller whose overshoot and settling time hold in time, on the nominal loop and on drawn
plants.

Algorithm 2 asks that |S| stay below |1 − T_d| up to a slack, of which overshoot and settling time
do not follow: plants that are not of second order overshoot more and settle later than T_d. Here
the two are constraints on the step responses themselves. Reference models of several bandwidths and
dampings give first controllers; from the best of them a simplex search minimises

    ℓ_q(ρ)   subject to   o_q(ρ) ≤ o,   ‖W_T T‖∞ < 1,

ℓ_q and o_q the settling time and the overshoot that the nominal loop and a share q of the drawn
plants stay below.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.identification.nelder_mead import nelder_mead
from residuum.robust_control.certificates import Measured, StepResponse, measured
from residuum.robust_control.loop import Loop, Weights
from residuum.robust_control.synthesis.constrained_structure import ControllerStructure
from residuum.robust_control.synthesis.structured_synthesis import (
    NoStabilisingStart,
    Synthesis,
    synthesise,
)
from residuum.robust_control.weights.performance_weight import (
    Infeasible,
    ReferenceModel,
    shortest_settling_time,
)

# share of the plants in the search that must keep the limits, so that `TimeAim.share` of others
# do
_SHARE_IN_DESIGN = 0.98
# reference models that first controllers are made for: parts of the overshoot, settling times
_DAMPINGS, _BANDWIDTHS = (1.0, 1e-2, 1e-4), 6
_SEARCHES, _EVALUATIONS = 2, 250  # simplex searches from the best of them, and evaluations of each
_FEW = 20  # plants by which controllers are ranked
# parts of the overshoot that the search aims at, one after the other, until plants that it has
# not seen keep the whole
_MARGINS = (0.97, 0.8, 0.6)
# part of the plants allowed to fail that may fail among those that the promise is read from
_CAUTION = 0.4
_STIFF = 20.0  # price of a limit that is broken by a factor e, in longest settling times


@dataclass(frozen=True)
class TimeAim:
    """Largest overshoot (0.01 = 1 %), longest settling time [s] into 2 %, and the share of drawn
    plants that must keep both.
    """

    overshoot: float
    settling_time: float
    share: float = 0.95


@dataclass(frozen=True, eq=False)
class TimeDesign:
    """A controller, and the settling time [s] that the nominal loop and the aim's share of the
    drawn plants reach with it.
    """

    design: Synthesis
    settling_time: float


def design_in_time(
    loop: Loop,
    plants: Sequence[TransferFunction],
    held_out: Sequence[TransferFunction],
    W_T: FloatArray,
    structure: ControllerStructure,
    aim: TimeAim,
    critical_frequency: float,
) -> TimeDesign:
    """The fastest controller of the structure that keeps the aim in time.

    Parameters
    ----------
    loop : Loop
        The nominal plant alone.
    plants, others : sequences of TransferFunction
        Drawn plants, in random order: those that the search follows, and those that the promise is
        read from.
    W_T : array, shape (k,)
        |Ŵ_T| on the loop's grid; ‖W_T T‖∞ < 1 is kept.
    critical_frequency : float
        Where |Ŵ_T| crosses 0 dB [rad/s].

    Raises
    ------
    Infeasible
        None was found; says what the nearest reaches. The search is local: it is no proof that
        there is none.
    """
    nearest = (math.inf, math.inf, math.inf)
    starts: list[FloatArray] = []
    for margin in _MARGINS:
        search = _Search(loop, plants, W_T, structure, aim, margin)
        best = search.best(starts or search.from_weights(critical_frequency))
        norm = search.norm(best)
        steps = measured(
            search.nominal, held_out, structure.transfer_function(best), search.duration
        )
        settling_time = _promised(steps, aim)
        if settling_time <= aim.settling_time and norm < 1.0:
            design = Synthesis(
                structure,
                best,
                structure.transfer_function(best),
                norm,
                norm,
                search.worst_frequency(best),
                loop,
            )
            return TimeDesign(design, settling_time)
        starts, nearest = [best], min(nearest, (*search.reached(best), norm))
    raise Infeasible(
        f"aim in time: none was found that overshoots by at most {100 * aim.overshoot:.3g} % and"
        f" settles within {aim.settling_time:.4g} s on the nominal loop and {100 * aim.share:g} %"
        f" of the drawn plants; the nearest overshoots by {100 * nearest[0]:.3g} %, settles in"
        f" {nearest[1]:.4g} s and has ‖W_T T‖∞ = {nearest[2]:.4g} (below 1 is allowed)"
    )


def _promised(steps: Measured, aim: TimeAim) -> float:
    """The settling time within which the nominal loop and enough of the plants settle, overshooting
    no more than asked.
    """

    def within(step: StepResponse) -> float:
        return step.settling_time if step.overshoot <= aim.overshoot else math.inf

    share = 1.0 - _CAUTION * (1.0 - aim.share)
    return max(
        within(steps.nominal),
        float(np.quantile([within(step) for step in steps.drawn], share, method="higher")),
    )


class _Search:
    """What a controller reaches in time, and the merit that the search lowers."""

    def __init__(
        self,
        loop: Loop,
        plants: Sequence[TransferFunction],
        W_T: FloatArray,
        structure: ControllerStructure,
        aim: TimeAim,
        margin: float,
    ) -> None:
        self.loop, self.plants, self.structure = loop, list(plants), structure
        self.W_T, self.aim, self.margin = W_T, aim, margin
        # the cost with W_S = 0 is |W_T T| alone
        self.weights = Weights(np.zeros(len(W_T)), W_T)
        self.duration = 1.5 * aim.settling_time  # [s] that steps are followed for
        self.nominal = next(plant for plant in loop.plants if isinstance(plant, TransferFunction))
        bounds = structure.bounds()
        self.low = np.array([-np.inf if low is None else low for low, _ in bounds])
        self.high = np.array([np.inf if high is None else high for _, high in bounds])

    def from_weights(self, critical_frequency: float) -> list[FloatArray]:
        """Controllers by mixed sensitivity for reference models of several bandwidths and
        dampings.
        """
        rhos: list[FloatArray] = []
        for scale in _DAMPINGS:
            overshoot = scale * self.aim.overshoot
            fastest = min(
                shortest_settling_time(overshoot, critical_frequency), 0.5 * self.aim.settling_time
            )
            for settling_time in np.geomspace(fastest, 2.0 * self.aim.settling_time, _BANDWIDTHS):
                W_S = ReferenceModel(overshoot, float(settling_time)).weight_magnitude(
                    self.loop.omega
                )
                # from the controller of the reference model before it, which is near
                starts = rhos[-1:] or None
                try:
                    rhos.append(
                        synthesise(
                            self.loop, Weights(W_S, self.W_T), self.structure, starts=starts
                        ).rho
                    )
                except NoStabilisingStart:
                    break
        return rhos

    def best(self, candidates: Sequence[FloatArray]) -> FloatArray:
        """The parameters of least merit, from the best of the candidates.

        Raises Infeasible without a candidate.
        """
        if not candidates:
            raise Infeasible(
                f"aim in time: no controller {self.structure.name!r} that stabilises the plant was"
                " found"
            )
        # ranked by a few plants, searched by all
        ranked = sorted(candidates, key=lambda rho: self.merit(rho, _FEW))
        minima = [
            nelder_mead(self.merit, self.simplex(rho), _EVALUATIONS) for rho in ranked[:_SEARCHES]
        ]
        return self.clipped(min(minima, key=self.merit))

    def simplex(self, rho: FloatArray) -> FloatArray:
        """Corners about a controller: each parameter by a fifth of itself, at least by a fiftieth
        of its usual size.
        """
        size = self.structure.sizes(*self.loop.gain_and_time_constant)
        return np.vstack([rho, rho + np.diag(np.maximum(0.2 * np.abs(rho), 0.02 * size))])

    def clipped(self, rho: FloatArray) -> FloatArray:
        """The nearest parameters within their bounds."""
        return np.asarray(np.clip(rho, self.low, self.high))

    def merit(self, rho: FloatArray, plants: int | None = None) -> float:
        """Settling time over the longest allowed, and a steep price for what breaks a limit."""
        rho = self.clipped(rho)
        if not self.loop.stabilised_by(*self.structure.polynomials(rho)):
            return 1e6
        overshoot, settling_time = self.reached(rho, plants)
        norm = self.norm(rho)
        late = settling_time / self.aim.settling_time
        # where a loop does not settle, its error is what can fall
        if not math.isfinite(late):
            late = 2.0 + self._error(rho)
        over = max(0.0, math.log(max(overshoot, 1e-12) / (self.margin * self.aim.overshoot)))
        return late + _STIFF * over + _STIFF * max(0.0, math.log(max(norm, 1e-12) / 0.999))

    def reached(self, rho: FloatArray, plants: int | None = None) -> tuple[float, float]:
        """(overshoot, settling time) that the nominal loop and nearly all plants of the search stay
        below.
        """
        steps = self._measured(rho, plants)
        overshoot, settling_time = steps.reached_by(max(_SHARE_IN_DESIGN, self.aim.share))
        return max(overshoot, steps.nominal.overshoot), max(
            settling_time, steps.nominal.settling_time
        )

    def norm(self, rho: FloatArray) -> float:
        """‖W_T T‖ on the finer grid."""
        return float(self._cost(rho).max())

    def worst_frequency(self, rho: FloatArray) -> float:
        """Where |W_T T| is largest [rad/s]."""
        return float(self.loop.finer[0].omega[int(np.argmax(self._cost(rho)))])

    def _measured(self, rho: FloatArray, plants: int | None = None) -> Measured:
        return measured(
            self.nominal, self.plants[:plants], self.structure.transfer_function(rho), self.duration
        )

    def _error(self, rho: FloatArray) -> float:
        """Integral of the error over the time followed, for a loop that does not settle within
        it.
        """
        steps = self._measured(rho, _FEW).drawn
        return float(np.median([step.integral_absolute_error for step in steps])) / self.duration

    def _cost(self, rho: FloatArray) -> FloatArray:
        fine, position = self.loop.finer
        K = fine.controller_response(*self.structure.polynomials(rho))
        return np.asarray(fine.cost(K, self.weights.between(position)).max(axis=0))
