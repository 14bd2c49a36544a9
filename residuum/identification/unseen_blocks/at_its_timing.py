"""The search in records, at a lower rate first where that loses nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from residuum.identification.physics import PhysicalModel
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.coarser import coarser
from residuum.identification.unseen_blocks.data import matched
from residuum.identification.unseen_blocks.search import search
from residuum.identification.unseen_blocks.tried import Search, Wanted
from residuum.identification.work import OutOfWork, Tell, left_out, untold


def searched(
    model: PhysicalModel, records: Sequence[Record], mapping: Mapping[str, str] | None, wanted: Wanted, tell: Tell = untold
) -> Search:
    """The search; in noise, at the rate of the records.

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
            return search(finer, wanted, tell)
        except OutOfWork:
            left_out("the samples between those of a lower rate")
    return found
