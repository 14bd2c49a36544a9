"""A model simulated and linearised where a structure was fitted, once a block or at every sample."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.policy.likelihood import COARSER
from residuum.identification.discrepancy.policy.trials import MOVED_AT_REST
from residuum.identification.discrepancy.screening.in_blocks import Sampled
from residuum.identification.errors import NoExplicitEquations
from residuum.identification.physics import PhysicalModel, Simulator

FloatArray = npt.NDArray[np.float64]

Linear = tuple[list[FloatArray], list[FloatArray], list[FloatArray]]
"""Per experiment: residuals (blocks, outputs), and their slopes by parameters and by initial states."""


def simulation_error(model: PhysicalModel, there: Sampled) -> float:
    """Sum of the outputs' log mean square simulation errors; ∞ where the model diverges."""
    try:
        simulator = Simulator(model)
    except NoExplicitEquations:
        return np.inf
    base, experiments = there.base, there.experiments
    initial = _beside(base.initial, simulator)
    runs = simulator.run_each(experiments, initial, simulator.p(), substeps=base.substeps)
    if not runs.bounded:
        return np.inf
    power, count = np.nansum(runs.errors**2, axis=0), np.isfinite(runs.errors).sum(axis=0)
    return float(np.sum(np.log(np.maximum(power[count > 0] / count[count > 0], 1e-300))))


def at_rest(model: PhysicalModel, own: list[str], there: Sampled) -> Linear | None:
    """The linearisation where an effect without size leaves everything as it is: the base's, and its own slopes beside.

    None where it does not.
    """
    base, experiments = there.base, there.experiments
    try:
        simulator = Simulator(model)
    except NoExplicitEquations:
        return None
    if len(simulator.states) > len(base.initial[0]):
        return None
    runs = simulator.run_each(experiments, base.initial, simulator.p(), slopes=own, substeps=base.substeps)
    if runs.dY is None or not runs.bounded:
        return None
    moved = np.abs(np.concatenate(runs.means(runs.errors)) - np.concatenate(base.residuals))
    if np.nanmax(moved / base.rmse, initial=0.0) > MOVED_AT_REST:
        return None
    each = zip(base.by_parameters, runs.means(runs.dY), strict=True)
    by_parameters = [np.concatenate(slopes, axis=2) for slopes in each]
    return base.residuals, by_parameters, base.by_states


def linearised(model: PhysicalModel, names: list[str], there: Sampled) -> Linear | None:
    """The model linearised in these parameters and its free first states; None where it diverges or is too fast to be seen."""
    try:
        simulator = Simulator(model)
    except NoExplicitEquations:  # this combination of effects has no explicit equations
        return None
    states = [f"initial:{name}" for name in simulator.free_states]
    p = simulator.p()
    base, experiments = there.base, there.experiments
    initial, steps = _beside(base.initial, simulator), list(base.substeps)
    if len(simulator.states) > len(base.initial[0]):  # only new states can be faster than the base's
        wanted = simulator.substeps_along_each(experiments, _beside(there.X, simulator), p)
        steps = [max(s, -(-fast // COARSER)) for s, fast in zip(steps, wanted, strict=True)]
    if max(steps) > there.most_substeps:
        return None
    runs = simulator.run_each(experiments, initial, p, slopes=[*names, *states], substeps=steps)
    if runs.dY is None or not runs.bounded:
        return None
    q, slopes = len(names), runs.means(runs.dY)
    return runs.means(runs.errors), [J[:, :, :q] for J in slopes], [J[:, :, q:] for J in slopes]


def _beside(states: Sequence[FloatArray], simulator: Simulator) -> list[FloatArray]:
    """The base's states with an effect's own beside them, which its kernel sets first."""
    more = len(simulator.states) - states[0].shape[-1]
    return [np.concatenate([x, np.zeros((*x.shape[:-1], more))], axis=-1) for x in states] if more else list(states)
