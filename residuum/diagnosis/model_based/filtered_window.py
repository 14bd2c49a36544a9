"""A window followed by the Kalman filter of a model, and what each parameter, balance and input would have done to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.identification.physics import Experiment, PhysicalModel, Simulator
from residuum.identification.physics.model import missing_name
from residuum.identification.physics.simulate.filter_sensitivities import one_step_slopes
from residuum.identification.physics.simulate.kalman_recursions import kalman_filter

Array = npt.NDArray[np.float64]

_TRACE = 1e-5
"""Process noise of each state a sample, in its scale: one that stands still stays open to correction."""

_MOST_RESTARTS = 12
_AWAY, _LONG = 5.0, 5
"""Deviations, and samples in a row, from which on a filter that takes the machine to stick has lost it."""


@dataclass(frozen=True, eq=False)
class FilterNoise:
    """What the filter assumes of chance.

    What a balance lacks is taken to be white, not a walk: a walk would follow every lasting change of the machine, and nothing
    of it would be left in the innovations.

    Attributes
    ----------
    output_variance : array, shape (outputs,)
        Of each reading.
    process : array, shape (states, states)
        Covariance that a sample adds to the states.
    """

    output_variance: Array
    process: Array


@dataclass(frozen=True, eq=False)
class Filtered:
    """One window along the filter's track.

    Attributes
    ----------
    before, after : array, shape (n, NX)
        States before and after each sample was used.
    P, F, H, e, V : arrays
        As `kalman_filter` gives them.
    G, C : arrays, shapes (n, NX, columns) and (n, NY, columns)
        What the filter's `columns` do within a sample and to the reading.
    """

    experiment: Experiment
    before: Array
    after: Array
    P: Array
    F: Array
    H: Array
    e: Array
    V: Array
    G: Array
    C: Array

    @property
    def follows(self) -> bool:
        """Whether the filter stayed with the record to its end."""
        V = self.V[np.isfinite(self.experiment.Y)]
        return bool(np.all(np.isfinite(V)) and np.all(V > 0.0) and np.all(np.isfinite(self.after)))

    @property
    def normalised(self) -> Array:
        """Innovations over their standard deviation, shape (n, outputs), NaN where nothing was measured."""
        return np.asarray(self.e / np.sqrt(self.V))

    @property
    def log_likelihood(self) -> float:
        """Of the innovations; −∞ where the filter diverged. Readings that it could not follow count as if they were far out."""
        used = np.isfinite(self.e)
        if not self.follows:
            return -np.inf
        skipped = np.isfinite(self.experiment.Y) & ~used
        penalty = 0.5 * float(np.sum(_AWAY**2 + np.log(2.0 * np.pi * self.V[skipped])))
        return -penalty + float(-0.5 * np.sum(self.e[used] ** 2 / self.V[used] + np.log(2.0 * np.pi * self.V[used])))

    @property
    def predicted(self) -> Array:
        """What each output was expected to read, shape (n, outputs)."""
        return np.asarray(self.experiment.Y - self.e)

    @property
    def judged_share(self) -> float:
        """Share of the readings that the filter held against the model."""
        judged, read = np.isfinite(self.e), np.isfinite(self.experiment.Y)
        return float(judged.sum()) / max(float(read.sum()), 1.0)


class TrackingFilter:
    """The extended Kalman filter of a model whose columns cover parameters, balances and inputs.

    Parameters
    ----------
    model : PhysicalModel
        With the values that the window is held against.
    noise : FilterNoise
    scales : array, shape (states,)
        Size of each state: the doubt of its first value.
    substeps : int
        Integration steps a sample.

    Attributes
    ----------
    columns : tuple of str
        `parameter:name` of each parameter of the model, `balance:name` of each balance, `input:name` of each recorded input.
    """

    def __init__(self, model: PhysicalModel, noise: FilterNoise, scales: Array, substeps: int) -> None:
        self.model, self.noise, self.scales, self.substeps = model, noise, scales, substeps
        open_model, offsets = model, {}
        for name, signal in model.inputs.items():
            if not signal.absent:
                open_model = open_model.with_effect("input-offset", name)
                offsets[name] = f"{open_model.effects[-1].label}.u_0"
        self.simulator = Simulator(open_model)
        names = {f"parameter:{name}": name for name in model.all_parameters}
        names |= {f"balance:{name}": missing_name(name) for name in model.balances}
        names |= {f"input:{name}": parameter for name, parameter in offsets.items()}
        self.columns = tuple(names)
        self._slopes = self.simulator.columns(list(names.values()))
        self._walking = self.simulator.columns([])
        self._filtered = self.simulator.columns([f"initial:{name}" for name in self.simulator.states])

    def with_values(self, values: Mapping[str, float]) -> TrackingFilter:
        """The same filter of the model with other values."""
        return TrackingFilter(self.model.with_values(values), self.noise, self.scales, self.substeps)

    def with_noise(self, noise: FilterNoise) -> TrackingFilter:
        """The same filter with other noise."""
        return TrackingFilter(self.model, noise, self.scales, self.substeps)

    def start(self, experiment: Experiment) -> Array:
        """First states: those that the model fixes, the first reading of those that are outputs, zero elsewhere."""
        x0, states = self.simulator.x0(), list(self.simulator.states)
        for o, output in enumerate(self.model.outputs.values()):
            seen = experiment.Y[np.isfinite(experiment.Y[:, o]), o]
            if output.value.text in states and output.value.text not in self.model.initial and seen.size:
                x0[states.index(output.value.text)] = seen[0]
        return x0

    def run(self, experiment: Experiment, values: Mapping[str, float] | None = None, *, slopes: bool = True) -> Filtered:
        """Follow one window, with these values replaced; without `slopes` G and C are empty."""
        q, p = self.simulator.kernel.system, self.simulator.p(values)
        z, P, F, H, e, V, after = self._followed(experiment, p)
        Ts, U = experiment.sample_time, np.ascontiguousarray(experiment.U)
        if not slopes or not np.all(np.isfinite(after)):
            none = np.zeros((experiment.n, 0, 0))
            return Filtered(experiment, z, after, P, F, H, e, V, none, none)
        G, C = one_step_slopes(q, U, z, after, p, self._walking, self._slopes, Ts, self.substeps, experiment.hold)
        return Filtered(experiment, z, after, P, F, H, e, V, G, C)

    def _followed(self, experiment: Experiment, p: Array) -> tuple[Array, ...]:
        """The filter's arrays over the window, begun anew where it had lost a machine that it took to stick."""
        found, start = list(self._from(experiment, p)), 0
        for _ in range(_MOST_RESTARTS):
            lost = _lost(found[2][start:], found[4][start:], found[5][start:], len(self.simulator.states))
            if lost is None or start + lost[1] >= experiment.n - 1:
                break
            begun, noticed = start + lost[0], start + lost[1]
            again = self._from(experiment.window(noticed, experiment.n), p)
            for array, rest in zip(found, again, strict=True):
                array[noticed:] = rest
            found[4][begun:noticed] = np.nan  # what was read meanwhile is held against nothing
            found[2][noticed - 1] = 0.0
            start = noticed
        return tuple(found)

    def _from(self, experiment: Experiment, p: Array) -> tuple[Array, ...]:
        """The filter's arrays from the window's first readings on."""
        Ts, P0, z0 = experiment.sample_time, np.diag(self.scales**2), self.start(experiment)
        Q = np.diag((_TRACE * self.scales) ** 2) + self.noise.process
        U, Y = np.ascontiguousarray(experiment.U), np.ascontiguousarray(experiment.Y)
        q, r = self.simulator.kernel.system, self.noise.output_variance
        return tuple(kalman_filter(q, U, Y, p, z0, P0, Q, r, self._filtered, Ts, self.substeps, experiment.hold))

    def states(self, filtered: Filtered) -> Array:
        """States along the track, shape (n, states)."""
        return np.ascontiguousarray(filtered.after[:, : len(self.simulator.states)])


def _lost(F: Array, e: Array, V: Array, states: int) -> tuple[int, int] | None:
    """Where a filter first lost the machine: from which sample on it stuck, and at which it is noticed; None where it did not.

    A state that sticks is not corrected by any reading: friction takes away what a correction gives.
    """
    sticks = np.any(np.all(F[:, :states, :states] == 0.0, axis=2), axis=1)
    if not sticks.any():
        return None
    with np.errstate(invalid="ignore"):
        away = sticks & np.any(np.abs(e) > _AWAY * np.sqrt(V), axis=1)
    noticed = np.flatnonzero(np.convolve(away, np.ones(_LONG), "valid") >= _LONG)
    if not noticed.size:
        return None
    at = int(noticed[0]) + _LONG
    free = np.flatnonzero(~sticks[: at - _LONG])
    return (int(free[-1]) + 1 if free.size else 0), at


def largest_substeps(model: PhysicalModel, experiments: Sequence[Experiment], starts: Sequence[Array]) -> int:
    """Integration steps a sample that the most demanding of several windows asks for."""
    simulator = Simulator(model)
    return int(max(simulator.substeps_each(experiments, starts, simulator.p())))
