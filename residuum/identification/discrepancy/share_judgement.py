"""From a search by share to candidates with probabilities, and to the structures that the other rooms work with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from residuum.identification.discrepancy.candidate import Candidate, Quantity
from residuum.identification.discrepancy.held_out_blocks import Blocks, Errors, cross_judged, looked_at
from residuum.identification.discrepancy.judgement import Judgement
from residuum.identification.discrepancy.policy.answers import LEFT_OVER, MOST_OF_A_GROUP, UNDECIDED
from residuum.identification.discrepancy.search_state import Search
from residuum.identification.discrepancy.share import Shared, ShareStep
from residuum.identification.discrepancy.share_search import ShareSearch
from residuum.identification.discrepancy.structure_fits import fit_structure
from residuum.identification.discrepancy.structures import Structure
from residuum.identification.physics import Experiment, PhysicalModel


def as_search(shares: ShareSearch, base: Structure, experiments: Sequence[Experiment], count: int) -> Search:
    """The accepted effects as structures on the experiments, each estimated from the values of its blocks."""
    found = Search(base=base, best=base, count=count)
    for step in shares.steps:
        if step.accepted is None:
            break
        others = [s for s in step.judged if s.key in step.group][:MOST_OF_A_GROUP]
        refitted = {s.key: structure for s in others if (structure := _refitted(found.best, s, experiments)) is not None}
        if step.accepted.key not in refitted:
            break
        found.before.append(found.best)
        found.alternatives.append(refitted)
        found.accepted.append(step.accepted.key)
        found.best = refitted[step.accepted.key]
    return found


def _refitted(before: Structure, shared: Shared, experiments: Sequence[Experiment]) -> Structure | None:
    use = shared.model.effects[-1]
    start = before.model.with_effect(use.id, use.target, {name: p.value for name, p in use.parameters.items()})
    return fit_structure(start, experiments, before.initial)


def judged(shares: ShareSearch, found: Search) -> Judgement:
    """Candidates of the accepted steps: a group shares the probability that one of it is missing, equally."""
    listed = [c for k, step in enumerate(shares.steps[: len(found.accepted)]) for c in _candidates(step, found, k)]
    if not listed:
        return _undecided(shares, found)
    first = shares.steps[0]
    last = next((s.accepted for s in reversed(shares.steps) if s.accepted is not None), None)
    left = float(last.errors.relative(last_before(shares)).sum()) if last is not None else 1.0
    named = sum(c.probability for c in listed if c.step == 0)
    none = first.accepted.p_value if first.accepted is not None else 1.0
    return Judgement("missing-effect", tuple(listed), min(none, 1.0 - named), max(0.0, 1.0 - named - none), min(left, 1.0))


def _undecided(shares: ShareSearch, found: Search) -> Judgement:
    """Nothing is real: those that took away most are told, each far from certain."""
    tried = [s for s in shares.steps[0].judged if s.share > s.std] if shares.steps else []
    tried = sorted(tried, key=lambda s: -s.share)[:MOST_OF_A_GROUP]
    each = (1.0 - UNDECIDED) / max(len(tried), 1)
    listed = tuple(_candidate(s, shares.steps[0], found, 0, each, ()) for s in tried)
    return Judgement("unknown-effect", listed, 0.0, UNDECIDED, 1.0)


def last_before(shares: ShareSearch) -> Errors:
    """Errors of the model as it was before the last accepted effect."""
    return next(step.before for step in reversed(shares.steps) if step.accepted is not None)


def _candidates(step: ShareStep, found: Search, number: int) -> list[Candidate]:
    accepted = step.accepted
    assert accepted is not None
    listed = []
    claimed = (1.0 - LEFT_OVER - min(accepted.p_value, LEFT_OVER)) * step.tried
    for shared in [s for s in step.judged if s.key in step.group]:
        others = tuple(k[0] for k in step.group if k != shared.key)
        listed.append(_candidate(shared, step, found, number, claimed / len(step.group), others))
    return listed


def _candidate(
    shared: Shared, step: ShareStep, found: Search, number: int, probability: float, others: tuple[str, ...]
) -> Candidate:
    structure = found.alternatives[number].get(shared.key) if number < len(found.alternatives) else None
    use = shared.model.effects[-1]
    doubts: Mapping[str, float] = {}
    values = {name: p.value for name, p in use.parameters.items()}
    if structure is not None:
        label = f"{structure.label_of(shared.key)}."
        doubts = {n.removeprefix(label): s for n, s in zip(structure.parameters, structure.std.tolist(), strict=True)}
        values = {n: structure.model.values[label + n] for n in values}
    parameters = {n: Quantity(values[n], float(doubts.get(n, 0.0)), p.unit) for n, p in use.parameters.items()}
    with np.errstate(invalid="ignore"):
        o = int(np.nanargmin(shared.errors.rms / step.before.rms))
    output = list(shared.model.outputs.values())[o]
    bounds = [p for p in use.parameters.values() if not p.fixed and p.value in (p.lower, p.upper)]
    return Candidate(
        effect=shared.key[0],
        balance=shared.key[1],
        probability=probability,
        indistinguishable_from=others,
        parameters=parameters,
        error_before=float(step.before.rms[o]),
        error_after=float(shared.errors.rms[o]),
        error_unit=output.unit,
        output=output.name,
        within_bounds=not bounds,
        evidence=-float(np.log(max(shared.p_value, 1e-300))),
        step=number,
        held_out=True,
        share=Quantity(shared.share, shared.std, ""),
    )


def with_shares(candidates: Sequence[Candidate], found: Search, blocks: Blocks) -> tuple[Candidate, ...]:
    """Candidates of another search with the share that each takes away on the blocks kept aside."""
    return tuple(replace(c, share=_share(c, found, blocks)) for c in candidates)


def _share(candidate: Candidate, found: Search, blocks: Blocks) -> Quantity | None:
    step, key = candidate.step, candidate.key
    if step >= len(found.alternatives) or key not in found.alternatives[step]:
        return None
    errors = [_errors(model, blocks) for model in (found.before[step].model, found.alternatives[step][key].model)]
    before, after = errors
    if before is None or after is None:
        return None
    gain = before.relative(before) - after.relative(before)
    return Quantity(float(gain.sum()), float(np.sqrt(len(gain)) * gain.std(ddof=1)), "")


def _errors(model: PhysicalModel, blocks: Blocks) -> Errors | None:
    found = cross_judged(looked_at(model, blocks), blocks)
    return None if found is None else found[1]


def because(candidate: Candidate) -> str:
    """One sentence for the candidate: how much it takes away, of what, and what may stand for it."""
    if candidate.share is None:
        return f"{candidate.effect} at {candidate.balance} makes the records more likely than the model without it"
    share = f"{100 * candidate.share.value:.0f} ± {100 * candidate.share.std:.0f} %"
    alike = f"; {' or '.join(candidate.indistinguishable_from)} would do as well" if candidate.indistinguishable_from else ""
    return f"{candidate.effect} at {candidate.balance} takes away {share} of the error's power on blocks kept aside{alike}"


def does_better(shares: ShareSearch, model: PhysicalModel) -> bool:
    """Whether the search by share leaves less on the blocks kept aside than another's model does."""
    own, other = _errors(shares.model, shares.blocks), _errors(model, shares.blocks)
    if own is None or other is None:
        return own is not None
    base = shares.steps[0].before
    return float(np.sum(np.log(own.relative(base) + 1e-12) - np.log(other.relative(base) + 1e-12))) < 0.0
