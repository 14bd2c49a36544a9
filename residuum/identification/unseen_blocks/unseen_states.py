"""Where windows begin in the states that no output shows: where the filter went."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from residuum.identification.physics import Simulator
from residuum.identification.unseen_blocks.data import Rung
from residuum.identification.unseen_blocks.following import Track
from residuum.identification.unseen_blocks.looks import Court
from residuum.identification.unseen_blocks.structure import Structure


def with_unseen_states(parent: Structure, along: Track, court: Court) -> Structure:
    """The structure whose windows of a short look begin where the filter went, in the states that
    no output shows.

    No fit moves these: the position of an axis of which the speed is measured is 0 at the begin of
    every window, and no stop is where the axis met it.
    """
    rung, names = court.middle, list(Simulator(parent.model).states)
    unseen = _unseen_states(parent, court.last)
    if not unseen or rung.windows not in parent.states:
        return parent
    rows = along.X[court.data.rows(rung)[rung.starts[:-1]]]
    filtered = [{n: float(x[names.index(n)]) for n in unseen} for x in rows]
    states = [
        {**known, **more} for known, more in zip(parent.states[rung.windows], filtered, strict=True)
    ]
    return replace(parent, states={**parent.states, rung.windows: states})


def _unseen_states(parent: Structure, last: Rung) -> list[str]:
    """States whose first values no measured output feels, on the first window of a rung."""
    simulator, part = Simulator(parent.model), last.parts[0]
    names = [f"initial:{name}" for name in simulator.free_states]
    x0 = simulator.x0({**parent.states[last.windows][0], **part.known})
    run = (
        simulator.run_vectors(
            part, x0, simulator.p(), slopes=names, substeps=parent.steps[last.windows][0]
        )
        if names
        else None
    )
    if run is None or run.dY is None:
        return []
    return [
        n
        for n, felt in zip(
            simulator.free_states, np.any(run.dY[:, part.measured], axis=(0, 1)), strict=True
        )
        if not felt
    ]
