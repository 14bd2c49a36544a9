"""The search at the input timing that suits what it finds: the timing of the data was chosen before anything was found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from residuum.identification.physics import PhysicalModel
from residuum.identification.record import Record
from residuum.identification.residual_analysis.input_timing import innovations_of
from residuum.identification.unseen_blocks.coarser import coarser, turned
from residuum.identification.unseen_blocks.data import matched
from residuum.identification.unseen_blocks.search import search
from residuum.identification.unseen_blocks.structure import fitted
from residuum.identification.unseen_blocks.tried import Search, Wanted
from residuum.identification.work import OutOfWork, Tell, left_out, untold


def searched(
    model: PhysicalModel, records: Sequence[Record], mapping: Mapping[str, str] | None, wanted: Wanted, tell: Tell = untold
) -> Search:
    """The search, at the input timing that suits what it found.

    Raises
    ------
    BadRecord, BadUnit
        Columns that do not fit the model, records too short for blocks.
    NotIdentifiable
        The model diverges on a record.
    """
    found = search(coarser(matched(model, records, mapping)), wanted, tell)
    if found.court.scale.nats and (finer := found.court.data.finer) is not None:  # in noise every sample counts
        try:
            found = search(finer, wanted, tell)
        except OutOfWork:
            left_out("the samples between those of a lower rate")
            return found
    try:
        return _at_its_timing(found, wanted, tell)
    except OutOfWork:
        left_out("the other input timing")
        return found


def _at_its_timing(found: Search, wanted: Wanted, tell: Tell) -> Search:
    """The search at the other input timing, where what was found fits better there: the timing was chosen without it."""
    court, best = found.court, found.best
    if not best.keys:
        return found
    other = turned(court.data)
    rung = other.rung(court.last.windows)
    states, taken = best.structure.states[court.last.windows], best.structure.steps[court.last.windows]
    there = fitted(best.model, rung, states, court.scale, steps=10, tolerance=1e-4, substeps=taken)
    here = innovations_of(np.split(best.errors, court.last.starts[1:-1]))
    if there is None or innovations_of(there.residuals) >= here:
        return found
    return search(other, wanted, tell, turn=False)
