"""The answer: what takes away most on blocks that no fit has seen."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from residuum.identification.discrepancy.estimated_values import estimated_values
from residuum.identification.discrepancy.explanation import Explanation
from residuum.identification.physics.estimation.coloured_covariance import coloured_covariance
from residuum.identification.record import Record
from residuum.identification.residual_analysis.compare import compare
from residuum.identification.residual_analysis.feedback import innovation_variance
from residuum.identification.residual_analysis.policy import SLOW
from residuum.identification.unseen_blocks.advice import next_experiments, undetectable
from residuum.identification.unseen_blocks.free_term import BlockTerm, free_terms
from residuum.identification.unseen_blocks.next_experiment import HELD, HeldValue
from residuum.identification.unseen_blocks.policy import UNKNOWN_LEADS
from residuum.identification.unseen_blocks.tried import Search, Wanted
from residuum.identification.unseen_blocks.verdict import (
    BlockErrors,
    Candidate,
    Step,
    block_errors,
    is_timing,
    remaining,
    steps_of,
    verdict_on,
)
from residuum.identification.work import begun


def answer_on_blocks(
    search: Search,
    wanted: Wanted,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None,
    began: float,
) -> Explanation:
    """The answer by errors on unseen blocks."""
    best, stds, steps = search.best, doubts_of(search), steps_of(search)
    free = free_terms(search.base, search.court)
    left = _left(search)
    # few answers to few steps look like a walk at random
    slow = any(times > SLOW for _, _, times in left.values())
    adequate = not slow and not compare(best.model, records, mapping, refuse_unstable=False).present
    verdict = verdict_on(search, steps, free, stds, adequate=adequate)
    free_beside = free_terms(best, search.court) if best.keys else free
    named = {key for step in steps for judged in (step.after, *step.group) for key in judged.keys}
    return Explanation(
        verdict=verdict.verdict,
        candidates=verdict.candidates,
        probability_none=verdict.none,
        probability_unknown=verdict.unknown,
        unexplained_share=_unexplained(search, free_beside),
        free=next(iter(free_beside), None),
        undetectable=undetectable(search, wanted, search.along, named),
        next_experiment=next_experiments(search, verdict.candidates),
        accepted=tuple(
            s.key for s in steps if s.key.effect != HELD and not is_timing(s.key, search)
        ),
        timing=tuple(s.key for s in steps if is_timing(s.key, search)),
        drifting=verdict.unknown > UNKNOWN_LEADS and bool(free) and free[0].axis == "time",
        left=left,
        values=estimated_values(search.court.data.model, best.model, stds),
        held=tuple(_held(s, search, stds) for s in steps if s.key.effect == HELD),
        remaining=remaining(search.base, best, search.court),
        blocks=_block_errors(search, verdict.candidates),
        work=begun(),
        seconds=time.perf_counter() - began,
        found=search,
    )


def _block_errors(search: Search, candidates: Sequence[Candidate]) -> BlockErrors:
    data, base = search.court.data, search.base
    alone = {
        c.key: search.every[(c.key,)].squares
        for c in candidates
        if c.step == 0 and (c.key,) in search.every
    }
    records = [block * len(data.experiments) // data.blocks for block in range(data.blocks)]
    times = [data.times_of(block) for block in range(data.blocks)]
    return block_errors(
        data.model, records, times, base.count, base.squares, search.best.squares, alone
    )


def doubts_of(search: Search) -> dict[str, float]:
    """Standard deviations of the best structure's parameters by full name, in noise of the colour
    that is left.
    """
    fit = search.court.begun(search.best.structure)
    if fit is None:
        return {}
    std = np.sqrt(np.maximum(np.diag(coloured_covariance(fit, search.court.last.parts)), 0.0))
    return dict(zip(fit.parameters, std.tolist(), strict=True))


def _unexplained(search: Search, terms: Sequence[BlockTerm]) -> float:
    """Part of what could be explained that only the best free term explains."""
    if not terms:
        return 0.0
    named = max(search.base.cost - search.best.cost, 0.0)
    more = max(search.best.cost - terms[0].cost, 0.0)
    return more / (more + named) if more > 0.0 else 0.0


def _left(search: Search) -> dict[str, tuple[float, str, float]]:
    best, parts = search.best, np.split(search.best.errors, search.court.last.starts[1:-1])
    left = {}
    for o, output in enumerate(best.model.outputs.values()):
        if search.court.data.measured[o]:
            errors = [p[:, o] for p in parts]
            rms = float(np.sqrt(np.nanmean(np.concatenate(errors) ** 2)))
            left[output.name] = (
                rms,
                output.unit,
                rms / max(float(np.sqrt(innovation_variance(errors))), 1e-300),
            )
    return left


def _held(step: Step, search: Search, stds: Mapping[str, float]) -> HeldValue:
    """The fixed value that is doubted; of several that do as much the first of the model."""
    model, tied = search.court.data.model, {step.key.target: search}
    for rival in step.group:
        tied |= {
            k.target: replace(search, best=rival)
            for k in rival.keys
            if k.effect == HELD and k not in search.best.keys
        }
    first, *alike = sorted(tied, key=list(model.parameters).index)
    doubt = stds if tied[first] is search else doubts_of(tied[first])
    before, now = model.parameters[first], tied[first].best.model.parameters[first]
    return HeldValue(
        first, before.value, now.value, float(doubt.get(first, 0.0)), now.unit, tuple(alike)
    )
