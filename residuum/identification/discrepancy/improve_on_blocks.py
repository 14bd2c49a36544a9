"""Improve a model that no structure of the catalogue makes exact: what takes away most on unseen blocks joins it.

All records are cut into blocks; every block is judged by a model that was estimated without it, so nothing has to be set aside
for good. The effects that `explain` found on a part are judged once more on all of the data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from residuum.identification.discrepancy.on_blocks import doubts_of, search_on_blocks
from residuum.identification.discrepancy.search import Tell
from residuum.identification.physics import PhysicalModel
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.held_value import HELD
from residuum.identification.unseen_blocks.search import Search, Wanted, chain

ASIDE = "every block in turn"
"""What is kept aside, in words."""


@dataclass(frozen=True, eq=False)
class Joined:
    """The model on everything, and how its error on unseen blocks fell: `errors` begins with that of the model as it was.

    `std` are the standard deviations of its parameters by full name, `output` the one whose errors are told.
    """

    model: PhysicalModel
    added: list[str]
    errors: list[float]
    std: Mapping[str, float]
    output: str


def joined_on_blocks(
    model: PhysicalModel,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None,
    effects: Sequence[str] | None,
    *,
    learned: bool,
    seconds: float | None,
    tell: Tell,
) -> Joined | None:
    """Add those of the `effects` (None: all that fit) that are real on unseen blocks; None where there are no blocks.

    Values that the model holds stay.
    """
    wanted = Wanted(None if effects is None else tuple(effects), learned, held=False)
    found = search_on_blocks(model, records, mapping, wanted, seconds, tell)
    return None if found is None else joined_of(found)


def joined_of(found: Search) -> Joined:
    """What a search found, step by step."""
    steps = chain(found, found.best.keys)
    each, o = [found.base, *(after for _, _, after in steps)], _told(found)
    added = [key.effect for key, _, _ in steps if key.effect != HELD]
    errors = [float(one.rms[o]) for one in each]
    return Joined(each[-1].model, added, errors, doubts_of(found), list(found.best.model.outputs)[o])


def _told(found: Search) -> int:
    """The output whose error falls most."""
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = found.best.rms / found.base.rms
    return int(np.nanargmin(np.where(np.isfinite(ratio), ratio, np.inf)))
