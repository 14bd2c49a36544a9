"""The input timing that suits what was found: the timing of the data was chosen before anything was."""

from __future__ import annotations

from residuum.identification.residual_analysis.input_timing import innovations_of
from residuum.identification.unseen_blocks.coarser import turned
from residuum.identification.unseen_blocks.data import Data
from residuum.identification.unseen_blocks.structure import fitted
from residuum.identification.unseen_blocks.tried import Search


def at_the_timing_it_suits(found: Search) -> Data | None:
    """The data at the other input timing, where the best structure fits better there; None where it does not, or nothing drives
    the machine.
    """
    court, best = found.court, found.best
    if not best.model.inputs:
        return None
    other = turned(court.data)
    states, taken = best.structure.states[court.last.windows], best.structure.steps[court.last.windows]
    here, there = (
        fitted(best.model, rung, states, court.scale, steps=10, tolerance=1e-4, substeps=taken)
        for rung in (court.last, other.rung(court.last.windows))
    )
    if here is None or there is None or innovations_of(there.residuals) >= innovations_of(here.residuals):
        return None
    return other
