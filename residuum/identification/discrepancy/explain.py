"""Explain: which physical effect is missing in a model?"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from residuum.identification.blas_threads import one_thread
from residuum.identification.discrepancy.evidence import ALIKE
from residuum.identification.discrepancy.free_term import FreeTerm, free_term
from residuum.identification.discrepancy.growth import Search
from residuum.identification.discrepancy.input_timing import experiments_and_base, turned_timing
from residuum.identification.discrepancy.judgement import Candidate, is_incomplete, judge
from residuum.identification.discrepancy.next_experiment import Proposal, next_experiments
from residuum.identification.discrepancy.search import Tell, search, untold
from residuum.identification.discrepancy.structures import (
    Structure,
    fit_structure,
    times_each_its_innovations,
    times_its_innovations,
)
from residuum.identification.discrepancy.trials import NOTHING_LEFT, SHIFTS, SLOW
from residuum.identification.discrepancy.visibility import Undetectable, undetectable
from residuum.identification.physics import Experiment, PhysicalModel
from residuum.identification.record import Record

MOST_SAMPLES = 6_000
_FINER, _FAR_LESS = 4, 0.3
"""How many times shorter windows are tried where the usual ones leave a slow error; and the share of it, in units of what its own
past cannot predict, to which it has to fall for them to be believed.
"""


@dataclass(frozen=True, eq=False)
class Explanation:
    """The answer.

    Attributes
    ----------
    verdict : str
        `missing-effect`, `adequate` or `unknown-effect`.
    candidates : tuple of Candidate
        The accepted effects first, the verdict's before all; probabilities of one step sum with those of "nothing" and
        "unknown" to at most one.
    probability_none, probability_unknown : float
    unexplained_share : float
        Part of what could be explained that no candidate explains.
    free : FreeTerm or None
        The smooth term that best explains the rest.
    undetectable, next_experiment
        What this experiment cannot show, and what would.
    finer : int
        How many times shorter than usual the windows of `experiments` are.
    """

    verdict: str
    candidates: tuple[Candidate, ...]
    probability_none: float
    probability_unknown: float
    unexplained_share: float
    free: FreeTerm | None
    undetectable: tuple[Undetectable, ...]
    next_experiment: tuple[Proposal, ...]
    search: Search
    experiments: list[Experiment]
    finer: int
    seconds: float

    @property
    def left(self) -> dict[str, tuple[float, str, float]]:
        """What the model with the accepted effects leaves of each measured output: RMS error, its unit, and how often that is
        what its own past cannot predict (`SLOW` and more: something slow is missing, or drifts).
        """
        best = self.search.best
        each = zip(best.model.outputs.values(), best.rmse, times_each_its_innovations(best), strict=True)
        return {o.name: (float(rms), o.unit, float(times)) for o, rms, times in each if np.isfinite(rms)}


def at_turned_timing(found: Search, experiments: list[Experiment]) -> tuple[list[Experiment], Structure] | None:
    """Experiments with the other input timing, and the base on them, where what was found is likelier there, or needs no shift.

    The timing was chosen with a model that lacked something. A delay or lag that is missing then makes up for half a sample, and
    so may effects that were found beside it; one by less than a sample may be no more than the wrong choice.
    """
    late = [key for key in found.accepted if key[0] in SHIFTS]
    if not late and not found.timing:
        return None
    best, turned = found.best, turned_timing(experiments)
    tried = [(_without(best, found.timing), -ALIKE)] if found.timing else []
    if late:
        others = [key for key in found.accepted if key not in late]
        tried += [(_without(best, others), ALIKE), (best.model, ALIKE)]
    for model, more in tried:
        complete = fit_structure(model, turned, found.base.initial, drifting=best.drifting)
        if complete is not None and complete.log_likelihood > best.log_likelihood - best.penalty(complete) + more:
            base = fit_structure(_without(found.base, found.timing), turned, found.base.initial)
            return None if base is None else (turned, base)
    return None


def _without(structure: Structure, keys: Sequence[tuple[str, str]]) -> PhysicalModel:
    """A structure's model without those of these effects that it has."""
    model = structure.model
    for use in model.effects:
        model = model.without_effect(use.label) if (use.id, use.target) in keys else model
    return model


def _searched(
    model: PhysicalModel,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None,
    effects: Iterable[str] | None,
    tell: Tell,
) -> tuple[Search, list[Experiment], int]:
    """What is missing, the experiments that say so, and how many times finer than usual they are cut.

    Over a window a machine that holds on what it lacks (a cog, a friction) takes another course at the least difference of its
    first state, and no structure reaches the top of its likelihood. Over a shorter one it does not.
    """
    wanted = None if effects is None else tuple(effects)

    def found_on(
        base: Structure, experiments: list[Experiment], begin: float, end: float, limit: float = np.inf
    ) -> tuple[Search, list[Experiment]]:
        def told(share: float, doing: str) -> None:
            tell(begin + (end - begin) * share, doing)

        def astray(found: Search) -> bool:
            return times_its_innovations(found.best) > limit

        def turned(found: Search) -> tuple[list[Experiment], Structure] | None:
            shifted = any(id in SHIFTS for id, _ in found.accepted)
            doubtful = shifted or times_its_innovations(found.best) > NOTHING_LEFT  # noise alone: the answer stands
            return at_turned_timing(found, experiments) if doubtful else None

        def leave(found: Search) -> bool:
            return astray(found) or turned(found) is not None

        found = search(base, experiments, nominal=model, effects=wanted, leave=leave, tell=told)
        if again := turned(found):
            experiments, base = again
            found = search(base, experiments, nominal=model, effects=wanted, leave=astray, tell=told)
        return found, experiments

    tell(0.0, "estimating the model as it is")
    usual, base = experiments_and_base(model, records, mapping, MOST_SAMPLES)
    cut = any(after.follows(before) for before, after in pairwise(usual))
    found, experiments = found_on(base, usual, 0.27, 0.6, limit=SLOW if cut else np.inf)
    left = times_its_innovations(found.best)
    if cut and left > SLOW:
        tell(0.6, "estimating the model over shorter windows")
        finely, finely_base = experiments_and_base(model, records, mapping, MOST_SAMPLES, _FINER)
        other, finely = found_on(finely_base, finely, 0.65, 0.9)
        if times_its_innovations(other.best) < _FAR_LESS * left:
            return other, finely, _FINER
        found, experiments = found_on(base, usual, 0.9, 1.0)
    return found, experiments, 1


@one_thread()
def explain(
    model: PhysicalModel,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None = None,
    *,
    effects: Iterable[str] | None = None,
    tell: Tell = untold,
) -> Explanation:
    """Name the physical effect that is missing in a model.

    Parameters
    ----------
    model : PhysicalModel
        Its free parameters are re-estimated; its structure is what is judged.
    records : sequence of Record
        Each is an experiment with its own initial states.
    mapping : mapping of model name to column
    effects : iterable of effect id
        Consider only these (default: all that fit the model).
    tell : callable
        Told how far the work is.

    Raises
    ------
    BadRecord, BadUnit, BadModel
        Columns that do not fit the model; an effect that is not in the catalogue.
    NotIdentifiable
        The model diverges on a record.

    Notes
    -----
    Fails where a disturbance is synchronous with the input, and where two effects act alike in this experiment (they are
    then named as a group).
    """
    began = time.perf_counter()
    found, experiments, finer = _searched(model, records, mapping, effects, lambda share, doing: tell(0.75 * share, doing))
    tell(0.75, "drawing what no effect explains")
    free = free_term(found.best, experiments)
    judgement = judge(found, free, incomplete=is_incomplete(found, experiments))
    tell(0.85, "what could not have been seen, and the next experiment")
    return Explanation(
        verdict=judgement.verdict,
        candidates=judgement.candidates,
        probability_none=judgement.none,
        probability_unknown=judgement.unknown,
        unexplained_share=judgement.unexplained_share,
        free=free,
        undetectable=undetectable(found),
        next_experiment=next_experiments(found, judgement.candidates, experiments),
        search=found,
        experiments=experiments,
        finer=finer,
        seconds=time.perf_counter() - began,
    )
