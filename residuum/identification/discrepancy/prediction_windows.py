"""Plants that integrate are judged by prediction over windows, each with its own initial states."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from residuum.identification.physics import Experiment, PhysicalModel, Simulator, windows

_LASTING = 0.3
_SHORTEST, _LONGEST, _PARTS = 80, 1200, 25


def in_windows(model: PhysicalModel, experiments: Sequence[Experiment]) -> list[Experiment]:
    """The experiments, cut into windows where the outputs never forget an initial state.

    Over a whole record the simulation of such a plant drifts with every small error of its input (and in closed loop with
    the controller's answer to the noise); over a window with states of its own it does not.
    """
    found: list[Experiment] = []
    for e in experiments:
        samples = int(np.clip(e.n // _PARTS, _SHORTEST, _LONGEST))
        found += windows(e, samples) if e.n > 2 * samples and _integrates(model, e) else [e]
    return found


def _integrates(model: PhysicalModel, experiment: Experiment) -> bool:
    """Whether some measured output still feels some initial state at the end of the record."""
    states = [f"initial:{name}" for name in model.states if name not in model.initial]
    simulator = Simulator(model)
    run = simulator.run_vectors(experiment, simulator.x0(), simulator.p(), slopes=states)
    if not states or run.dY is None or not np.all(np.isfinite(run.dY)):
        return False
    slopes = np.abs(run.dY[:, experiment.measured])
    tenth = max(1, experiment.n // 10)
    late, peak = slopes[-tenth:].mean(axis=0), slopes.max(axis=0)
    return bool(np.any((peak > 0) & (late > _LASTING * peak)))
