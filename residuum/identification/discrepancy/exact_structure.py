"""The search for an exact structure: one that leaves nothing but noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from residuum.identification.discrepancy.fitting.judged_experiments import experiments_and_base
from residuum.identification.discrepancy.fitting.structures import Structure, times_its_innovations
from residuum.identification.discrepancy.judging.completeness import at_the_noise
from residuum.identification.discrepancy.judging.experiments_to_blame import searched
from residuum.identification.discrepancy.policy.acceptance import (
    EXACT_TIME,
    EXACT_WORK,
    FAR_ABOVE_SENSORS,
    FAR_FROM_NOISE,
    MOST_HELD,
)
from residuum.identification.discrepancy.searching.held_values import wrongly_held
from residuum.identification.discrepancy.searching.last_look import keep_what_shows
from residuum.identification.discrepancy.searching.search_state import Search
from residuum.identification.physics import Experiment, PhysicalModel, candidates, noise_floor
from residuum.identification.record import Record
from residuum.identification.residual_analysis.compare import compare
from residuum.identification.unseen_blocks.data import long_enough
from residuum.identification.unseen_blocks.held_value import freed
from residuum.identification.work import OutOfWork, Tell, at_most, left_out, part_of


@dataclass(frozen=True, eq=False)
class Exact:
    """What was found, the experiments, how many times shorter than usual their windows are, and the fixed values that are
    doubted.
    """

    found: Search
    experiments: list[Experiment]
    finer: int
    doubted: list[list[str]]


def is_far_from_noise(first: tuple[list[Experiment], Structure], records: Sequence[Record]) -> bool:
    """Whether the model as it is leaves an error so far from noise that one effect hardly leaves noise alone, in records long
    enough for blocks to judge.
    """
    return times_its_innovations(first[1]) > FAR_FROM_NOISE and long_enough([record.n for record in records])


def exact_in_bounds(
    first: tuple[list[Experiment], Structure],
    model: PhysicalModel,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None,
    wanted: Sequence[str] | None,
    seconds: float | None,
    tell: Tell,
) -> Exact | None:
    """What the search for an exact structure found with its part of the work, from the model as it is on its experiments on;
    None where it is not done by then.
    """
    try:
        with at_most(EXACT_WORK, None if seconds is None else EXACT_TIME * seconds):
            return _exact(first, model, records, mapping, wanted, tell)
    except OutOfWork:
        left_out("the search for an exact structure, to its end")
        tell(1.0, "no exact structure was found with the work for it")
        return None


def nothing_found(
    model: PhysicalModel, records: Sequence[Record], mapping: Mapping[str, str] | None, wanted: Sequence[str] | None
) -> Exact:
    """The model as it is, where no search came to an end."""
    experiments, base = experiments_and_base(model, records, mapping)
    return Exact(Search(base, base, len(candidates(model, wanted))), experiments, 1, [])


def is_structured(found: Search, records: Sequence[Record], mapping: Mapping[str, str] | None) -> bool:
    """Whether `compare` finds structure in what is left, where nothing was found that is missing, and nothing that drifts."""
    return not (found.accepted or found.drifting) and compare(found.best.model, records, mapping).present


def names_nothing(exact: Exact) -> bool:
    """Whether neither an effect was found nor a fixed value that is doubted."""
    return not (exact.found.accepted or exact.doubted)


def leaves_more_than_noise(exact: Exact) -> bool:
    """Whether a search for an exact structure ended without one: what is left stands above the noise of its own fast part, or far
    above that of the sensors.

    What drifts has a mean in every neighbouring block, and an effect would stand for it: then nothing is named.
    """
    best = exact.found.best
    floor = noise_floor(np.concatenate([e.Y for e in exact.experiments]))
    far = np.any(best.rmse[floor > 0.0] > FAR_ABOVE_SENSORS * floor[floor > 0.0])
    return not exact.found.drifting and (bool(far) or not at_the_noise(best))


def _exact(
    first: tuple[list[Experiment], Structure],
    model: PhysicalModel,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None,
    wanted: Sequence[str] | None,
    tell: Tell,
) -> Exact:
    doubted: list[list[str]] = []
    found, experiments, finer = searched(model, records, mapping, wanted, part_of(tell, 0.0, 0.9), first)
    while len(doubted) < MOST_HELD and (names := wrongly_held(found, experiments)):
        doubted.append(names)
        again = freed(model, [names[0] for names in doubted])
        found, experiments, finer = searched(again, records, mapping, wanted, part_of(tell, 0.9, 1.0))
    keep_what_shows(found, experiments)
    return Exact(found, experiments, finer, doubted)
