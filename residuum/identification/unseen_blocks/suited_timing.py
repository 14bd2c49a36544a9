"""The input timing that suits what was found: the timing of the data was chosen before anything was."""

from __future__ import annotations

import numpy as np

from residuum.identification.residual_analysis.input_timing import innovations_of
from residuum.identification.unseen_blocks.coarser import turned
from residuum.identification.unseen_blocks.data import Data
from residuum.identification.unseen_blocks.structure import fitted
from residuum.identification.unseen_blocks.tried import Search


def at_the_timing_it_suits(found: Search) -> Data | None:
    """The data at the other input timing, where the best structure fits better there; None where it does not."""
    court, best = found.court, found.best
    other = turned(court.data)
    rung = other.rung(court.last.windows)
    states, taken = best.structure.states[court.last.windows], best.structure.steps[court.last.windows]
    there = fitted(best.model, rung, states, court.scale, steps=10, tolerance=1e-4, substeps=taken)
    here = innovations_of(np.split(best.errors, court.last.starts[1:-1]))
    return None if there is None or innovations_of(there.residuals) >= here else other
