"""The climb to the top of a model's likelihood, the colour of its noise re-estimated at every step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.fitting.whitened_least_squares import NormalEquations
from residuum.identification.discrepancy.policy.likelihood import (
    CLIMBED,
    CLOSE,
    HARDEST_DAMPING,
    MOST_STRETCHED,
    OPTIMISM,
    SAME_WAY,
    SMALL_STEP,
)
from residuum.identification.physics import Experiment, PhysicalModel, Simulator
from residuum.identification.residual_analysis.coarse_reading import reading_variances
from residuum.identification.residual_analysis.noise.innovations import Noises, fit_noises, pointwise_log_likelihood
from residuum.identification.residual_analysis.policy.noise import SCORING
from residuum.identification.work import count_fit, go_on

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Point:
    """Parameters (in kernel order) and first states, and what a simulation there leaves: as in a `Structure`."""

    p: FloatArray
    initial: list[FloatArray]
    residuals: list[FloatArray]
    by_parameters: list[FloatArray]
    by_states: list[FloatArray]
    noises: Noises
    pointwise: FloatArray
    rmse: FloatArray

    @property
    def log_likelihood(self) -> float:
        """Of the innovations there."""
        return float(self.pointwise.sum())


class Ascent:
    """Levenberg–Marquardt on the innovations' likelihood, the noise re-estimated at every point."""

    def __init__(
        self,
        model: PhysicalModel,
        experiments: Sequence[Experiment],
        drifting: bool,
    ):
        self.simulator, self.experiments, self.names = Simulator(model), list(experiments), tuple(model.free)
        names = self.names
        known = model.all_parameters
        self.lower = np.array([known[name].lower for name in names])
        self.upper = np.array([known[name].upper for name in names])
        self.index = self.simulator.columns(names)
        states = self.simulator.free_states
        self.states = [self.simulator.states.index(name) for name in states]
        self.slopes = [*names, *(f"initial:{name}" for name in states)]
        self.drifting, self.reading = drifting, reading_variances(experiments)
        self.substeps: tuple[int, ...] = ()
        self.count = np.sum([np.isfinite(e.Y).sum(axis=0) for e in self.experiments], axis=0)

    def point(self, p: FloatArray, initial: list[FloatArray]) -> Point | None:
        """Simulate with derivatives; None when that diverges."""
        runs = self.simulator.run_each(self.experiments, initial, p, slopes=self.slopes, substeps=self.substeps)
        if runs.dY is None or not runs.bounded:
            return None
        q, power = len(self.names), np.nansum(runs.errors**2, axis=0)
        residuals, slopes = runs.means(runs.errors), runs.means(runs.dY)
        by_parameters, by_states = [J[:, :, :q] for J in slopes], [J[:, :, q:] for J in slopes]
        noises = self._noises(residuals)
        rmse = np.sqrt(power / np.where(self.count > 0, self.count, np.nan))
        pointwise = pointwise_log_likelihood(residuals, noises)
        return Point(p, initial, residuals, by_parameters, by_states, noises, pointwise, rmse)

    def log_likelihood(self, p: FloatArray, initial: list[FloatArray]) -> float:
        """At a point, without derivatives; −∞ where the simulation diverges."""
        runs = self.simulator.run_each(self.experiments, initial, p, substeps=self.substeps)
        if not runs.bounded:
            return -np.inf
        residuals = runs.means(runs.errors)
        return float(pointwise_log_likelihood(residuals, self._noises(residuals)).sum())

    def _noises(self, residuals: list[FloatArray]) -> Noises:
        return fit_noises(residuals, drifting=self.drifting, reading=self.reading)

    def choose_steps(self, initial: list[FloatArray], most: float, enough: Sequence[int] = ()) -> bool:
        """Set the integration steps a sample of each experiment; False when its fastest mode asks for more than `most`.

        Where so many were exact `enough` before an effect joined, only a faster mode asks for more.
        """
        p = self.simulator.p()
        modal = self.simulator.modal_substeps(self.experiments, initial, p)
        if max(modal) > most:
            return False
        exact = map(max, modal, enough) if enough else self.simulator.substeps_each(self.experiments, initial, p, modal)
        self.substeps = tuple(exact)
        return True

    def climb(self, here: Point, iterations: int, rival: float = -np.inf) -> Point:
        """Walk up until a step gains nothing, or is not promised to come near a rival's log-likelihood.

        A small step is Fisher's, whose curvature is less than that of the weighted squares (`SCORING`); a large one takes the
        weights as they are, and ends where a residual linear in the parameters vanishes. Both take the noise for known, and are
        too short where the noise changes with them: along a ridge, on which three steps on end point the same way, they are
        stretched.
        """
        damping, refused, stretch, last, on = 1e-4, False, 1.0, np.zeros(len(self.names)), 0
        count_fit()
        for _ in range(iterations):
            go_on()
            equations = NormalEquations.of(here.residuals, here.by_parameters, here.by_states, here.noises)
            promised = equations.decrement()
            if here.log_likelihood + OPTIMISM * promised + CLOSE < rival or (stretch == 1.0 and promised < 0.5 * CLIMBED):
                break
            before, first = here, damping
            scoring = SCORING if promised < SMALL_STEP * here.pointwise.size else 1.0
            while damping < HARDEST_DAMPING:
                trial = self._trial(here, equations, damping, stretch * scoring)
                if not refused or self.log_likelihood(*trial) > here.log_likelihood:  # where one was refused, the next may be
                    there = self.point(*trial)
                    if there is not None and there.log_likelihood > here.log_likelihood:
                        refused = damping > first
                        here, damping = there, max(damping / 10.0, 1e-9)
                        break
                damping = damping if stretch * scoring > 1.0 else damping * 8.0
                refused, stretch, scoring = True, 1.0, 1.0
            done, plain = here.log_likelihood - before.log_likelihood < CLIMBED, stretch == 1.0
            if done and plain:
                break
            step = (here.p - before.p)[self.index] / np.where(before.p[self.index] == 0.0, 1.0, before.p[self.index])
            on = on + 1 if _same_way(step, last) and not done else 0
            stretch, last = (min(2.0 * stretch, MOST_STRETCHED) if on > 1 else 1.0), step
        return here

    def _trial(
        self, here: Point, equations: NormalEquations, damping: float, stretch: float
    ) -> tuple[FloatArray, list[FloatArray]]:
        """Parameters and first states after the damped step, stretched, within bounds."""
        theta = here.p[self.index]
        held = np.zeros(len(theta), dtype=bool)
        for _ in range(len(theta) + 1):
            step, own = equations.step(damping, held)
            out = ~held & ((theta <= self.lower) & (step < 0) | (theta >= self.upper) & (step > 0))
            if not out.any():
                break
            held |= out
        p = here.p.copy()
        p[self.index] = np.clip(theta + stretch * step, self.lower, self.upper)
        initial = []
        for x0, z in zip(here.initial, own, strict=True):
            x = x0.copy()
            x[self.states] += stretch * z
            initial.append(x)
        return p, initial


def _same_way(step: FloatArray, last: FloatArray) -> bool:
    """Whether two steps of the parameters, relative to their values, point the same way."""
    return bool(step @ last > SAME_WAY * np.linalg.norm(step) * np.linalg.norm(last) > 0.0)
