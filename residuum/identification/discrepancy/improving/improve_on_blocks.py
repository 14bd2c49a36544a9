"""Improve a model that no structure of the catalogue makes exact: what takes away most on unseen blocks joins it.

All records are cut into blocks; every block is judged by a model that was estimated without it, so nothing has to be set aside
for good.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residuum.identification.discrepancy.improvement import Step
from residuum.identification.discrepancy.improving.begin_improving import Request
from residuum.identification.discrepancy.improving.ends_kept_aside import steps_that_hold
from residuum.identification.discrepancy.on_blocks import doubts_of, search_on_blocks
from residuum.identification.errors import NotIdentifiable
from residuum.identification.physics import Estimate, PhysicalModel, estimate, with_coloured_noise
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.data import Data
from residuum.identification.unseen_blocks.held_value import HELD
from residuum.identification.unseen_blocks.remaining import remaining
from residuum.identification.unseen_blocks.steps import chain
from residuum.identification.unseen_blocks.tried import Search, Wanted
from residuum.identification.work import Tell

ASIDE = "every block in turn"
"""What is kept aside, in words."""


@dataclass(frozen=True, eq=False)
class Joined:
    """The model on everything, and how its error on unseen blocks fell: the `history` begins with that of the model as it was.

    `refused` are effects that are real on the blocks, and simulate the end of the records worse. `std` are the standard
    deviations of its parameters by full name, `output` the one whose errors are told.
    """

    model: PhysicalModel
    history: list[Step]
    refused: list[str]
    std: Mapping[str, float]
    output: str


def joined_on_blocks(model: PhysicalModel, records: Sequence[Record], found: Search, how: Request, tell: Tell) -> Joined:
    """Add the effects that were `found`; where that freed values, those found beside them as they are held."""
    if any(key.effect == HELD for key in found.best.keys):
        wanted = Wanted(None if how.effects is None else tuple(how.effects), how.learned, held=False)
        found = search_on_blocks(model, records, how.mapping, wanted, how.seconds, tell) or found
    return joined_of(found, records, how.mapping)


def joined_of(found: Search, records: Sequence[Record], mapping: Mapping[str, str] | None) -> Joined:
    """What a search found, step by step, as far as it holds at the end of the records."""
    steps = chain(found, [key for key in found.best.keys if key.effect != HELD])
    each, o = [found.base, *(after for _, _, after in steps)], _told(found)
    kept = steps_that_hold([one.model for one in each], found, records, mapping)
    names = [None, *(key.effect for key, _, _ in steps)]
    history = [
        Step(name, float(one.rms[o]), remaining=remaining(found.base, one, found.court))
        for name, one in zip(names, each[: kept + 1], strict=False)
    ]
    refused, output = [key.effect for key, _, _ in steps[kept:]], list(found.best.model.outputs)[o]
    if kept == 0 and (alone := _estimated(each[0].model, found.court.data.finer or found.court.data)) is not None:
        std = dict(zip(alone.parameters, alone.std.tolist(), strict=True))
        return Joined(alone.model, history, refused, std, output)
    return Joined(each[kept].model, history, refused, doubts_of(replace(found, best=each[kept])), output)


def _estimated(model: PhysicalModel, data: Data) -> Estimate | None:
    """The model that nothing joins at its least simulation error over whole records, which a search in windows does not seek."""
    try:
        return with_coloured_noise(estimate(model, data.experiments), data.experiments)
    except NotIdentifiable:
        return None


def _told(found: Search) -> int:
    """The output whose error falls most."""
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = found.best.rms / found.base.rms
    return int(np.nanargmin(np.where(np.isfinite(ratio), ratio, np.inf)))
