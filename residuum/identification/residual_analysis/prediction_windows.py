"""Plants that integrate are judged by prediction over windows, each with its own initial states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from residuum.identification.physics import Experiment, PhysicalModel, Simulator, windows
from residuum.identification.physics.simulate.kalman import Filter, first_noise
from residuum.identification.residual_analysis.policy.records import LASTING, LONGEST_PREDICTED, SHORTEST_PREDICTED, WINDOWS


def in_windows(model: PhysicalModel, experiments: Sequence[Experiment], finer: int = 1) -> list[Experiment]:
    """The experiments, cut into windows where the outputs never forget an initial state, so many times `finer` than usual.

    Over a whole record the simulation of such a plant drifts with every small error of its input (and in closed loop with
    the controller's answer to the noise); over a window with states of its own it does not.

    States that no output feels (a position where only speed is measured) go on from window to window as the measurements
    track them: free in every window, they would let whatever depends on them differ from one to the next.
    """
    found: list[Experiment] = []
    for e in experiments:
        samples = int(np.clip(e.n // WINDOWS, SHORTEST_PREDICTED, LONGEST_PREDICTED)) // finer
        felt = _lasting(model, e) if e.n > 2 * samples else None
        if felt is None or not any(share > LASTING for share in felt.values()):
            found.append(e)
            continue
        unfelt = [name for name, share in felt.items() if share == 0.0]
        found += _anchored(model, e, windows(e, samples), unfelt) if unfelt else windows(e, samples)
    return found


def _anchored(model: PhysicalModel, experiment: Experiment, parts: list[Experiment], states: list[str]) -> list[Experiment]:
    """The windows with these states known from the Kalman filter over the whole experiment."""
    simulator = Simulator(model)
    X = Filter(model, first_noise(model, [experiment])).run(experiment, simulator.x0(experiment.known)).X
    if not np.all(np.isfinite(X)):
        return parts
    rows = [round((part.t0 - experiment.t0) / experiment.sample_time) for part in parts]
    columns = {name: simulator.states.index(name) for name in states}
    return [
        replace(part, known={name: float(X[row, k]) for name, k in columns.items()})
        for part, row in zip(parts, rows, strict=True)
    ]


def _lasting(model: PhysicalModel, experiment: Experiment) -> dict[str, float] | None:
    """For each free initial state how much of its peak effect on a measured output is there at the end; None if it diverges."""
    states = [name for name in model.states if name not in model.initial and name not in experiment.known]
    simulator = Simulator(model)
    slopes = [f"initial:{name}" for name in states]
    run = simulator.run_vectors(experiment, simulator.x0(), simulator.p(), slopes=slopes)
    if not states or run.dY is None or not np.all(np.isfinite(run.dY)):
        return None
    size = np.abs(run.dY[:, experiment.measured])
    late, peak = size[-max(1, experiment.n // 10) :].mean(axis=0), size.max(axis=0)
    shares = np.divide(late, peak, out=np.zeros_like(late), where=peak > 0).max(axis=0)
    return dict(zip(states, shares.tolist(), strict=True))
