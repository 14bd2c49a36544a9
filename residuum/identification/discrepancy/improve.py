"""Improve: add effects to a model, re-estimate it, and count the error on data that were not used for it."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from residuum.identification.blas_threads import one_thread
from residuum.identification.discrepancy.begin_improving import Request, asked_for, explained, with_inputs_of
from residuum.identification.discrepancy.explain import Explanation
from residuum.identification.discrepancy.final_estimate import (
    doubts_of,
    least_simulation_error,
    on_everything,
    vanished,
    without_needless,
)
from residuum.identification.discrepancy.held_out import Split, split
from residuum.identification.discrepancy.held_out_error import HeldOutError
from residuum.identification.discrepancy.held_values import freed
from residuum.identification.discrepancy.improve_by_share import ASIDE, joined_by_share
from residuum.identification.discrepancy.improvement import Improvement, Step, with_provenance
from residuum.identification.discrepancy.join_effects import all_joined
from residuum.identification.discrepancy.policy.acceptance import EXPLAINING_TIME, STRANGE
from residuum.identification.discrepancy.proposals import uninformed
from residuum.identification.discrepancy.search import Tell, untold
from residuum.identification.discrepancy.structures import Structure
from residuum.identification.errors import BadModel
from residuum.identification.physics import Experiment, PhysicalModel, match
from residuum.identification.record import Record
from residuum.identification.residual_analysis.compare import compare
from residuum.identification.work import at_most

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _Attempt:
    """An improvement by one choice of what is kept aside, and whether that shows something that the rest does not: it refused an
    effect, or its error stands far above the rest's.
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
    the rest's, the beginning is kept aside instead: the end may show what the rest never did. The returned model is
    re-estimated on everything. Values that the model fixes stay, but for those named in `free`. The verdict is that of `compare`
    on the returned model: `adequate` where its error is not structured.

    Raises
    ------
    BadModel
        An effect that is not in the catalogue, does not fit the model, or fits several places and names none; a name in `free`
        that is no fixed parameter.
    NotIdentifiable
        The model diverges on a record.
    """
    _check_fixed(model, free)
    how = Request(mapping, add, effects, free, learned, None if seconds is None else EXPLAINING_TIME * seconds)
    with at_most() as work:
        found = _either_way(model, records, how, seconds, tell)
    return replace(found, work=work)


def _either_way(model: PhysicalModel, records: Sequence[Record], how: Request, seconds: float | None, tell: Tell) -> Improvement:
    """The improvement with the end of the records kept aside, or with the beginning where that end is strange."""
    began, parts = time.perf_counter(), split(records)
    found = _improved(model, records, parts, how, tell)
    if found.improvement.explanation is not None and found.improvement.explanation.by_share:
        return found.improvement
    if how.add is not None or not found.strange or len(records) > 1 or records[0].split is not None:
        return found.improvement
    again = split(records, end=False)
    spent = time.perf_counter() - began
    if again.aside == parts.aside or (seconds is not None and spent > EXPLAINING_TIME * seconds):
        return found.improvement
    later: Tell = lambda share, doing: tell(0.8 + 0.2 * share, doing)  # noqa: E731
    other = _improved(model, records, again, replace(how, seconds=None if seconds is None else seconds - spent), later)
    return found.improvement if other.strange else other.improvement


def _check_fixed(model: PhysicalModel, names: Sequence[str]) -> None:
    fixed = [name for name, p in model.parameters.items() if p.fixed]
    if unknown := [name for name in names if name not in fixed]:
        there = ", ".join(fixed) or "none"
        raise BadModel(f"free {unknown[0]!r}: is no parameter that model {model.name!r} holds fixed; there are {there}")


def _improved(model: PhysicalModel, records: Sequence[Record], parts: Split, how: Request, tell: Tell) -> _Attempt:
    tell(0.0, "estimating the model as it is")
    begun = explained(model, parts, how, tell) if how.add is None else asked_for(model, records, parts, how, how.add)
    explanation, experiments, finer = begun.explanation, begun.experiments, 1
    if explanation is not None:
        if explanation.by_share and (shared := _improved_by_share(model, records, explanation, how, tell)) is not None:
            return _Attempt(shared, False)
        finer = explanation.finer
    judge = HeldOutError(parts, experiments, begun.base, how.mapping, finer)
    history = [Step(None, judge.error(begun.as_it_was))]
    history += [Step(f"{name} freed", judge.error(begun.base)) for name in how.free]
    kept, refused = all_joined(begun, judge, history, tell)
    strange = refused or bool(np.any(judge.errors(kept) > STRANGE * kept.rmse))
    tell(0.8, "estimating on everything")
    kept, simulates_better = _slimmed(kept, experiments, judge, history, may_drop=how.add is None)
    final = on_everything(kept, records, how.mapping, finer, least_error=simulates_better)
    for use in vanished(final, history, [] if explanation is None else explanation.search.timing):
        final = replace(final, model=final.model.without_effect(use.label))
        history.append(Step(f"-{use.id}", history[-1].error))
    improved = uninformed(with_provenance(final.model, doubts_of(final), records, history, judge.output, judge.unit), model)
    fell = history[-1].error < history[0].error
    verdict = ("improved" if fell else "not-improved") if how.add is not None else _verdict(improved, records, how.mapping)
    return _Attempt(Improvement(improved, tuple(history), verdict, judge.output, judge.unit, explanation, parts.aside), strange)


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


def _improved_by_share(
    model: PhysicalModel, records: Sequence[Record], explanation: Explanation, how: Request, tell: Tell
) -> Improvement | None:
    """The model with what is real on blocks kept aside of all records; None where no blocks can be cut."""
    tell(0.6, "judging what was found on all records")
    knowing = with_inputs_of(freed(model, how.free), explanation.search.base.model)
    whole = match(knowing, records, how.mapping)[1]
    named = sorted({c.effect for c in explanation.candidates})
    began, joined = time.perf_counter(), None
    for ids in [named, how.effects] if named else [how.effects]:  # all that fit, where those named on a part do not hold on all
        left = None if how.seconds is None else how.seconds - (time.perf_counter() - began)
        joined = joined_by_share(knowing, whole, ids, learned=how.learned, seconds=left)
        if joined is None or joined.added:
            break
    if joined is None:
        return None
    history = [Step(id, error) for id, error in zip([None, *joined.added], joined.errors, strict=True)]
    unit = joined.model.outputs[joined.output].unit
    improved = with_provenance(joined.model, joined.std, records, history, joined.output, unit)
    improved = uninformed(improved, model)
    verdict = _verdict(improved, records, how.mapping)
    return Improvement(improved, tuple(history), verdict, joined.output, unit, explanation, ASIDE)


def _verdict(improved: PhysicalModel, records: Sequence[Record], mapping: Mapping[str, str] | None) -> str:
    """That of `compare` on the model as it will be written: `adequate`, or what is left has no name."""
    return "unknown-effect" if compare(improved, records, mapping).present else "adequate"
