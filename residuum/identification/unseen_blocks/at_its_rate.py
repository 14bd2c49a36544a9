"""The search in records, at a lower rate first where that loses nothing."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

from residuum.identification.physics import PhysicalModel
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.data import Data, coarser, matched
from residuum.identification.unseen_blocks.ladder import climb
from residuum.identification.unseen_blocks.policy import MOST_EFFORT
from residuum.identification.unseen_blocks.search import search
from residuum.identification.unseen_blocks.settling import begun
from residuum.identification.unseen_blocks.tried import Search, Wanted
from residuum.identification.work import OutOfWork, Tell, at_most, left_out, rising, untold


def searched(
    model: PhysicalModel,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None,
    wanted: Wanted,
    *,
    seconds: float | None = None,
    tell: Tell = untold,
) -> Search:
    """The search for what records show that a model lacks; in noise, at the rate of the records.

    It is the model as it is alone where the work, or the seconds that a user gave, are over before
    anything else is known.

    Raises
    ------
    BadRecord, BadUnit
        Columns that do not fit the model, records too short for blocks.
    NotIdentifiable
        The model diverges on a record.
    """
    data = matched(model, records, mapping)
    try:
        with at_most(MOST_EFFORT, seconds):
            return at_its_rate(data, partial(search, wanted=wanted, tell=rising(tell)))
    except OutOfWork:
        left_out("everything beside the model as it is")
        return begun(climb(coarser(data)))


def at_its_rate(data: Data, seek: Callable[[Data], Search]) -> Search:
    """What is sought in data, at a lower rate that loses nothing; in noise, where every sample
    counts, at their own.
    """
    outcome = seek(coarser(data))
    if outcome.court.scale.nats and (finer := outcome.court.data.finer) is not None:
        try:
            return seek(finer)
        except OutOfWork:
            left_out("the samples between those of a lower rate")
    return outcome
