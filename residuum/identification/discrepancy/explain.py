"""Explain: which physical effect is missing in a model?"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residuum.identification.blas_threads import one_thread
from residuum.identification.discrepancy.block_cutting import blocks_of
from residuum.identification.discrepancy.candidate import Candidate
from residuum.identification.discrepancy.completeness import at_the_noise, is_incomplete
from residuum.identification.discrepancy.experiments_to_blame import searched
from residuum.identification.discrepancy.free_term import FreeTerm, free_term
from residuum.identification.discrepancy.held_out_blocks import Blocks
from residuum.identification.discrepancy.held_values import HeldValue, freed, held_values, wrongly_held
from residuum.identification.discrepancy.judged_experiments import experiments_and_base
from residuum.identification.discrepancy.judgement import Judgement, judge
from residuum.identification.discrepancy.next_experiment import Proposal, next_experiments
from residuum.identification.discrepancy.policy.acceptance import EXACT_TIME, EXACT_WORK, MOST_HELD
from residuum.identification.discrepancy.policy.blocks import SHARE_WORK
from residuum.identification.discrepancy.proposals import informed
from residuum.identification.discrepancy.remaining import Remaining, remaining_on
from residuum.identification.discrepancy.search import Tell, untold
from residuum.identification.discrepancy.search_state import Search
from residuum.identification.discrepancy.share_judgement import as_search, does_better, judged, with_shares
from residuum.identification.discrepancy.share_search import ShareSearch, search_by_share
from residuum.identification.discrepancy.structures import times_each_its_innovations
from residuum.identification.discrepancy.visibility import Undetectable, undetectable
from residuum.identification.physics import Experiment, PhysicalModel, candidates, find_effect, match
from residuum.identification.record import Record
from residuum.identification.residual_analysis.compare import compare
from residuum.identification.work import OutOfWork, Work, at_most, begun, left_out


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
    held : tuple of HeldValue
        Parameters that the model holds fixed and that were freed, for another value does more than any effect.
    by_share : bool
        Whether the effects were named by what they take away on blocks kept aside, for no structure of the catalogue is exact.
    remaining : Remaining or None
        What the model with the accepted effects leaves on those blocks; None where the records are too short for any.
    work : Work
        Samples simulated, fits made, and what was not tried, since the work or the user's seconds were over.
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
    held: tuple[HeldValue, ...]
    by_share: bool
    remaining: Remaining | None
    work: Work
    seconds: float

    @property
    def left(self) -> dict[str, tuple[float, str, float]]:
        """What the model with the accepted effects leaves of each measured output: RMS error, its unit, and how often that is
        what its own past cannot predict (`SLOW` and more: something slow is missing, or drifts).
        """
        best = self.search.best
        each = zip(best.model.outputs.values(), best.rmse, times_each_its_innovations(best), strict=True)
        return {o.name: (float(rms), o.unit, float(times)) for o, rms, times in each if np.isfinite(rms)}


@one_thread()
def explain(
    model: PhysicalModel,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None = None,
    *,
    effects: Iterable[str] | None = None,
    learned: bool = False,
    seconds: float | None = None,
    tell: Tell = untold,
) -> Explanation:
    """Name the physical effect that is missing in a model.

    Parameters
    ----------
    model : PhysicalModel
        Its free parameters are re-estimated; its structure is what is judged, and whether a fixed value explains more.
    records : sequence of Record
        Each is an experiment with its own initial states.
    mapping : mapping of model name to column
    effects : iterable of effect id
        Consider only these (default: all that fit the model).
    learned : bool
        Where nothing with a name is real, learn a curve over one signal.
    seconds : float, optional
        Time after which the search is left as well as after its work; the answer then depends on the machine, and says so.
    tell : callable
        Told how far the work is.

    Returns
    -------
    The answer; its verdict is `adequate` only where `compare` finds no structure in what the re-estimated model leaves.

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
    wanted = None if effects is None else tuple(effects)
    with at_most():
        return _explained(model, records, mapping, wanted, learned, seconds, tell)


def _explained(
    model: PhysicalModel,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None,
    wanted: Sequence[str] | None,
    learned: bool,
    seconds: float | None,
    tell: Tell,
) -> Explanation:
    began = time.perf_counter()
    model, whole = _informed(model, records, mapping, wanted)
    exact, shares = _exact_in_bounds(model, records, mapping, wanted, seconds, tell), None
    structured = exact is not None and _is_structured(exact.found, records, mapping)
    if exact is None or structured or _leaves_more_than_noise(exact.found):
        tell(0.5, "what takes away most on blocks kept aside")
        with at_most(SHARE_WORK, None if seconds is None else seconds - (time.perf_counter() - began)):
            shares = search_by_share(model, whole, wanted, learned=learned)
    blocks = blocks_of(model, whole) if shares is None else shares.blocks
    by_share = exact is None or _is_inexact(exact.found, shares)
    last = _taken_by_share(model, records, mapping, wanted, shares) if exact is None or by_share else exact
    found, experiments = last.found, last.experiments
    tell(0.75, "drawing what no effect explains")
    free = free_term(found.best, experiments)
    if by_share:
        judgement = Judgement("unknown-effect", (), 0.0, 1.0, 1.0) if shares is None else judged(shares, found)
    else:
        judgement = _judged_as_exact(last, free, blocks, structured)
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
        finer=last.finer,
        held=held_values(model, last.doubted, found.best),
        by_share=by_share,
        remaining=None if blocks is None else remaining_on(found.best.model, blocks),
        work=begun(),
        seconds=time.perf_counter() - began,
    )


def _informed(
    model: PhysicalModel, records: Sequence[Record], mapping: Mapping[str, str] | None, wanted: Sequence[str] | None
) -> tuple[PhysicalModel, list[Experiment]]:
    """The model with columns of the records that may be forgotten inputs, and the whole records as its experiments."""
    _, whole = match(model, records, mapping)
    if wanted is not None and not any(find_effect(id).takes_columns for id in wanted):
        return model, whole
    knowing = informed(model, whole)
    return knowing, whole if knowing is model else match(knowing, records, mapping)[1]


@dataclass(frozen=True, eq=False)
class _Exact:
    """What a search found, exactly or by share, the experiments, how fine they are cut, and the fixed values that are doubted."""

    found: Search
    experiments: list[Experiment]
    finer: int
    doubted: list[list[str]]


def _exact_in_bounds(
    model: PhysicalModel,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None,
    wanted: Sequence[str] | None,
    seconds: float | None,
    tell: Tell,
) -> _Exact | None:
    """What the search for an exact structure found with its part of the work; None where it is not done by then."""
    try:
        with at_most(EXACT_WORK, None if seconds is None else EXACT_TIME * seconds):
            return _exact(model, records, mapping, wanted, tell)
    except OutOfWork:
        left_out("the search for an exact structure, to its end")
        tell(0.5, "no exact structure was found with the work for it")
        return None


def _taken_by_share(
    model: PhysicalModel,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None,
    wanted: Sequence[str] | None,
    shares: ShareSearch | None,
) -> _Exact:
    """What was accepted by its share in the place of an exact structure; nothing where no blocks could be cut."""
    experiments, base = experiments_and_base(model, records, mapping)
    count = len(candidates(model, wanted))
    found = Search(base, base, count) if shares is None else as_search(shares, base, experiments, count)
    return _Exact(found, experiments, 1, [])


def _judged_as_exact(exact: _Exact, free: FreeTerm | None, blocks: Blocks | None, structured: bool) -> Judgement:
    """The judgement on an exact structure, with shares; never `adequate` where `compare` finds what is left `structured`."""
    judgement = judge(exact.found, free, incomplete=is_incomplete(exact.found, exact.experiments))
    if blocks is not None:
        judgement = replace(judgement, candidates=with_shares(judgement.candidates, exact.found, blocks))
    if judgement.verdict == "adequate" and structured:
        judgement = replace(judgement, verdict="unknown-effect", none=judgement.unknown, unknown=judgement.none)
    return judgement


def _exact(
    model: PhysicalModel, records: Sequence[Record], mapping: Mapping[str, str] | None, wanted: Sequence[str] | None, tell: Tell
) -> _Exact:
    doubted: list[list[str]] = []
    found, experiments, finer = searched(model, records, mapping, wanted, lambda share, doing: tell(0.75 * share, doing))
    while len(doubted) < MOST_HELD and (names := wrongly_held(found, experiments)):
        doubted.append(names)
        again = freed(model, [names[0] for names in doubted])
        found, experiments, finer = searched(again, records, mapping, wanted, lambda _, doing: tell(0.75, doing))
    return _Exact(found, experiments, finer, doubted)


def _is_inexact(found: Search, shares: ShareSearch | None) -> bool:
    """Whether the structure found leaves more than noise, and what explains most on blocks kept aside does better there."""
    return shares is not None and bool(shares.accepted) and does_better(shares, found.best.model)


def _is_structured(found: Search, records: Sequence[Record], mapping: Mapping[str, str] | None) -> bool:
    """Whether `compare` finds structure in what is left, where nothing was found that is missing, and nothing that drifts."""
    return not (found.accepted or found.drifting) and compare(found.best.model, records, mapping).present


def _leaves_more_than_noise(found: Search) -> bool:
    """Whether a search for an exact structure ended without one.

    What drifts has a mean in every neighbouring block, and an effect would stand for it: then nothing is named.
    """
    return not found.drifting and not at_the_noise(found.best)
