"""Improve: add effects to a model, re-estimate it, and count the error on data that were not used for it."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residuum.identification.blas_threads import one_thread
from residuum.identification.discrepancy.explain import check_length
from residuum.identification.discrepancy.explanation import Explanation
from residuum.identification.discrepancy.fitting.structures import Structure
from residuum.identification.discrepancy.improvement import Improvement, Step, with_provenance
from residuum.identification.discrepancy.improving.begin_improving import Request, asked_for, begun_exactly, named, with_inputs_of
from residuum.identification.discrepancy.improving.final_estimate import (
    least_simulation_error,
    on_everything,
    vanished,
    without_needless,
)
from residuum.identification.discrepancy.improving.held_out import Split, split
from residuum.identification.discrepancy.improving.held_out_error import HeldOutError
from residuum.identification.discrepancy.improving.improve_on_blocks import ASIDE, joined_on_blocks
from residuum.identification.discrepancy.improving.join_effects import all_joined
from residuum.identification.discrepancy.policy.acceptance import EXPLAINING_TIME, STRANGE
from residuum.identification.errors import BadModel
from residuum.identification.physics import Experiment, Key, PhysicalModel
from residuum.identification.record import Record
from residuum.identification.residual_analysis.compare import compare
from residuum.identification.unseen_blocks.held_value import freed
from residuum.identification.unseen_blocks.proposals import without_idle
from residuum.identification.unseen_blocks.tried import Search
from residuum.identification.work import Tell, at_most, part_of, untold
from residuum.nearest_names import known_names


@dataclass(frozen=True, eq=False)
class _Attempt:
    """An improvement by one choice of what is kept aside, and whether that shows something that the rest does not. It does
    where it refused an effect, or where its error stands far above the rest's.
    """

    improvement: Improvement
    strange: bool


@one_thread()
def improve(
    model: PhysicalModel,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None = None,
    *,
    add: Sequence[str] | None = None,
    effects: Sequence[str] | None = None,
    free: Sequence[str] = (),
    learned: bool = False,
    seconds: float | None = None,
    tell: Tell = untold,
) -> Improvement:
    """Add the effects `add` (id or id@target), or with None those that `explain` accepts, one after the other.

    Parameters are estimated on the training part of the records; an effect proposed by `explain` is kept only while the
    simulation error on the rest does not rise. Where the end of a record refuses an effect, or its error stands far above
    the rest's, the beginning is kept aside instead: the end may show what the rest never did. Where no structure of the
    catalogue is exact, every block of the records is kept aside in turn, and what joins also simulates their end no worse.

    The returned model is re-estimated on everything. Where all that `explain` accepts would leave a larger error than the model
    as it was leaves, nothing joins (`refused` names it). Values that the model fixes stay, but for those named in `free`. The
    verdict is that of `compare` on the returned model: `adequate` where its error is not structured.

    Raises
    ------
    BadModel
        An effect that is not in the catalogue, does not fit the model, or fits several places and names none; a name in `free`
        that is no fixed parameter.
    NotIdentifiable
        The model diverges on a record.
    """
    _check_fixed(model, free)
    if add is None:
        check_length(records)
    how = Request(mapping, add, effects, free, learned, None if seconds is None else EXPLAINING_TIME * seconds)
    with at_most() as work:
        found = _either_way(model, records, how, seconds, tell)
    return replace(found, work=work)


def _either_way(model: PhysicalModel, records: Sequence[Record], how: Request, seconds: float | None, tell: Tell) -> Improvement:
    """The improvement with the end of the records kept aside, or with the beginning where that end is strange."""
    began, parts = time.perf_counter(), split(records)
    tell(0.0, "estimating the model as it is")
    said = named(model, records, parts, how, tell) if how.add is None else None
    if said is not None and said.on_blocks is not None:
        return _improved_on_blocks(model, records, said, said.on_blocks, how, tell)
    found = _improved(model, records, parts, said, how, tell)
    if how.add is not None or not found.strange or len(records) > 1 or records[0].split is not None:
        return found.improvement
    again = split(records, end=False)
    spent = time.perf_counter() - began
    if again.aside == parts.aside or (seconds is not None and spent > EXPLAINING_TIME * seconds):
        return found.improvement
    other = _improved(model, records, again, said, how, part_of(tell, 0.8, 1.0))
    return found.improvement if other.strange else other.improvement


def _check_fixed(model: PhysicalModel, names: Sequence[str]) -> None:
    fixed = [name for name, p in model.parameters.items() if p.fixed]
    if unknown := [name for name in names if name not in fixed]:
        there = known_names(unknown[0], fixed, "there are")
        raise BadModel(f"free {unknown[0]!r}: is no parameter that model {model.name!r} holds fixed; {there}")


def _improved(
    model: PhysicalModel, records: Sequence[Record], parts: Split, said: Explanation | None, how: Request, tell: Tell
) -> _Attempt:
    if said is not None and said.exact is not None:
        begun, finer = begun_exactly(model, parts, how, said.exact), said.exact.finer
    else:
        begun, finer = asked_for(model, records, parts, how, how.add or ()), 1
    experiments = begun.experiments
    judge = HeldOutError(parts, experiments, begun.base, how.mapping, finer)
    history = [judge.step(None, begun.as_it_was)]
    history += [judge.step(f"{name} freed", begun.base) for name in how.free]
    kept, refused = all_joined(begun, judge, history, tell)
    strange = refused or bool(np.any(judge.errors(kept) > STRANGE * kept.rmse))
    tell(0.8, "estimating on everything")
    kept, simulates_better = _slimmed(kept, experiments, judge, history, may_drop=how.add is None)
    if how.add is None and history[-1].error > history[0].error:
        kept, history, simulates_better = begun.as_it_was, history[:1], False
    worse = () if said is None else _not_joined(begun.chosen, history, said)
    final = on_everything(kept, records, how.mapping, finer, least_error=simulates_better)
    for use in vanished(final, history, [] if said is None else said.timing):
        final = replace(final, model=final.model.without_effect(use.label))
        history.append(Step(f"-{use.id}", history[-1].error))
    improved = without_idle(with_provenance(final.model, final.doubts, records, history, judge.output, judge.unit), model)
    fell = history[-1].error < history[0].error
    verdict = ("improved" if fell else "not-improved") if how.add is not None else _verdict(improved, records, how.mapping)
    return _Attempt(Improvement(improved, tuple(history), verdict, judge.output, judge.unit, said, parts.aside, worse), strange)


def _not_joined(chosen: Sequence[Key], history: Sequence[Step], said: Explanation) -> tuple[str, ...]:
    """What `explain` accepted and did not join, shifts in time apart."""
    told = {step.added for step in history}
    return tuple(key.effect for key in chosen if key not in said.timing and key.effect not in told)


def _slimmed(
    kept: Structure, experiments: Sequence[Experiment], judge: HeldOutError, history: list[Step], *, may_drop: bool
) -> tuple[Structure, bool]:
    """The structure without what is needless, where that `may_drop`, as the history tells; and whether it simulates better at its
    least simulation error.
    """
    if may_drop:
        kept, dropped = without_needless(kept, experiments, judge, history[-1].error)
        history += dropped
    plain = least_simulation_error(kept, experiments)
    if plain is None or not (error := judge.error(plain)) < history[-1].error:
        return kept, False
    history[:] = [replace(s, error=error) if s.together or s is history[-1] else s for s in history]
    return kept, True


def _improved_on_blocks(
    model: PhysicalModel, records: Sequence[Record], said: Explanation, found: Search, how: Request, tell: Tell
) -> Improvement:
    """The model with what is real on unseen blocks; without values that only `explain` frees."""
    joined = joined_on_blocks(with_inputs_of(freed(model, how.free), found.court.data.model), records, found, how, tell)
    unit = joined.model.outputs[joined.output].unit
    improved = with_provenance(joined.model, joined.std, records, joined.history, joined.output, unit)
    improved = without_idle(improved, model)
    verdict = _verdict(improved, records, how.mapping)
    return Improvement(improved, tuple(joined.history), verdict, joined.output, unit, said, ASIDE, tuple(joined.refused))


def _verdict(improved: PhysicalModel, records: Sequence[Record], mapping: Mapping[str, str] | None) -> str:
    """That of `compare` on the model as it will be written: `adequate`, or what is left has no name."""
    return "unknown-effect" if compare(improved, records, mapping).present else "adequate"
