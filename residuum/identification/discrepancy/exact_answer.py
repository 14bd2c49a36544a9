"""The answer where a structure of the catalogue is exact, or nothing better was found."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from residuum.identification.discrepancy.estimated_values import estimated_values
from residuum.identification.discrepancy.exact_structure import Exact
from residuum.identification.discrepancy.explanation import Explanation
from residuum.identification.discrepancy.fitting.structures import times_each_its_innovations
from residuum.identification.discrepancy.fitting.unseen_errors import Blocks, blocks_of, remaining_of, unseen
from residuum.identification.discrepancy.judging.completeness import is_incomplete
from residuum.identification.discrepancy.judging.free_term import FreeTerm, free_term
from residuum.identification.discrepancy.judging.judgement import Judgement, judge
from residuum.identification.discrepancy.next_experiment import next_experiments
from residuum.identification.discrepancy.screening.visibility import undetectable
from residuum.identification.discrepancy.searching.held_values import held_values
from residuum.identification.discrepancy.searching.search_state import Search
from residuum.identification.physics import PhysicalModel
from residuum.identification.unseen_blocks.block_errors import BlockErrors, block_errors
from residuum.identification.unseen_blocks.candidate import Candidate, Quantity
from residuum.identification.unseen_blocks.comparing import share
from residuum.identification.unseen_blocks.remaining import Remaining
from residuum.identification.work import begun


def answer_of(exact: Exact, model: PhysicalModel, *, searched: bool, structured: bool, began: float) -> Explanation:
    """The answer by the likelihood of structures; `searched`: whether the search came to its end, `structured`: whether `compare`
    finds structure in what it leaves.
    """
    found, experiments = exact.found, exact.experiments
    blocks, free = blocks_of(experiments), free_term(found.best, experiments)
    judgement = _judged(exact, free, structured=structured) if searched else Judgement("unknown-effect", (), 0.0, 1.0, 1.0)
    candidates, remaining, errors = judgement.candidates, None, None
    if blocks is not None:
        candidates, remaining, errors = _on_unseen(judgement.candidates, found, blocks)
    return Explanation(
        verdict=judgement.verdict,
        candidates=candidates,
        probability_none=judgement.none,
        probability_unknown=judgement.unknown,
        unexplained_share=judgement.unexplained_share,
        free=free,
        undetectable=undetectable(found),
        next_experiment=next_experiments(found, candidates, experiments),
        accepted=tuple(found.accepted),
        timing=tuple(found.timing),
        drifting=found.drifting,
        left=_left(found),
        values=estimated_values(model, found.best.model, found.best.doubts),
        held=held_values(model, exact.doubted, found.best),
        remaining=remaining,
        blocks=errors,
        work=begun(),
        seconds=time.perf_counter() - began,
        exact=exact,
    )


def _judged(exact: Exact, free: FreeTerm | None, *, structured: bool) -> Judgement:
    """The judgement on an exact structure; never `adequate` where `compare` finds what is left `structured`."""
    judgement = judge(exact.found, free, incomplete=is_incomplete(exact.found, exact.experiments))
    if judgement.verdict == "adequate" and structured:
        judgement = replace(judgement, verdict="unknown-effect", none=judgement.unknown, unknown=judgement.none)
    return judgement


def _on_unseen(
    candidates: Sequence[Candidate], found: Search, blocks: Blocks
) -> tuple[tuple[Candidate, ...], Remaining, BlockErrors]:
    """On blocks that no fit has seen: the candidates with the shares that they take away, what remains, and errors by block."""
    steps = range(min(len(found.before), len(found.alternatives)))
    there = {(c.step, c.key): found.alternatives[c.step].get(c.key) for c in candidates if c.step in steps}
    squares = {at: unseen(structure, blocks) for at, structure in there.items() if structure is not None}
    base, best = unseen(found.base, blocks), unseen(found.best, blocks)
    before = {k: base if found.before[k] is found.base else unseen(found.before[k], blocks) for k in {k for k, _ in squares}}
    shares = {(k, key): Quantity(*share(before[k], after), "") for (k, key), after in squares.items()}
    told = tuple(replace(c, share=shares.get((c.step, c.key))) for c in candidates)
    alone = {key: after for (k, key), after in squares.items() if k == 0}
    errors = block_errors(found.best.model, blocks.record, blocks.times, blocks.count, base, best, alone)
    return told, remaining_of(base, best, found.best, blocks), errors


def _left(found: Search) -> dict[str, tuple[float, str, float]]:
    best = found.best
    each = zip(best.model.outputs.values(), best.rmse, times_each_its_innovations(best), strict=True)
    return {o.name: (float(rms), o.unit, float(times)) for o, rms, times in each if np.isfinite(rms)}
