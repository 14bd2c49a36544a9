"""Improve: add effects to a model, re-estimate it, and count the error on data that were not used
for it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from residuum.identification.blas_threads import one_thread
from residuum.identification.discrepancy.explain import (
    Explanation,
    check_length,
    explained,
    leaves_something,
)
from residuum.identification.discrepancy.improvement import Improvement, Step, with_provenance
from residuum.identification.discrepancy.kept_aside import (
    first_that_holds,
    is_noted,
    matched_at,
    rmse_aside,
    split,
    testing_of,
)
from residuum.identification.discrepancy.policy import EXPLAINING_TIME
from residuum.identification.errors import BadModel, NotIdentifiable
from residuum.identification.physics import (
    Estimate,
    Experiment,
    Key,
    PhysicalModel,
    estimate,
    with_coloured_noise,
)
from residuum.identification.physics.model import fitting, takes_columns, tied_to
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.cross_validation import ValidatedFit
from residuum.identification.unseen_blocks.data import Data, data_of, matched
from residuum.identification.unseen_blocks.proposals import without_idle
from residuum.identification.unseen_blocks.record_search import at_its_rate, searched, with_asked
from residuum.identification.unseen_blocks.structure import HELD, Structure, freed
from residuum.identification.unseen_blocks.tried import Search, Wanted, chain, with_only
from residuum.identification.unseen_blocks.verdict import remaining
from residuum.identification.work import Tell, at_most, part_of, untold
from residuum.nearest_names import known_names

# What joins a model: the effects that were found, as far as they hold on data kept aside, or all
# that a user asks for.
# All records are cut into blocks; every block is judged by a model that was estimated without it,
# so nothing has to be set aside for good. Where a user notes which part of a record is for
# training, the rest of it judges.

ASIDE = "every block in turn"
"""What is kept aside, in words, where no user says which part."""

_Step = tuple[Key, ValidatedFit, ValidatedFit]


@dataclass(frozen=True, eq=False)
class Joined:
    """The model on everything, and how its error on data kept `aside` fell by `history`, the first
    that of the model as it was.

    `refused` are effects that are real on the blocks, and simulate the end of the records worse.
    `std` are the standard deviations of its parameters by full name, `output` the one whose errors
    are told.
    """

    model: PhysicalModel
    history: list[Step]
    refused: list[str]
    std: Mapping[str, float]
    output: str
    aside: str


def joined_of(
    search: Search,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None,
    *,
    asked: Sequence[Key] | None = None,
    was: PhysicalModel | None = None,
) -> Joined:
    """What a search found, step by step, as far as it holds at the end of the records; or all that
    was `asked`, in its order.

    `was` is the model before values of it were set free.
    """
    if asked is None:
        # A value that is freed is no effect, and joins nothing.
        every = chain(search, [key for key in search.best.keys if key.effect != HELD])
        steps = _that_hold(every, search, records, mapping)
    else:
        every = steps = _in_order(search, asked)
    rows = [_Row(None, None, search.base)]
    if was is not None:
        rows = _before(search, was)
    rows += [_Row(key.effect, key.target, after) for key, _, after in steps]
    final = steps[-1][2] if steps else search.base
    fits, o = [row.fit for row in rows], _most_mended(search)
    # where a user keeps a part aside it judges; else every block has been left out in turn
    if is_noted(records):
        errors = _on_the_rest(fits, o, search, records, mapping)
        model, std = _final(search, final, _every_sample(search, records, mapping), noted=True)
        aside = split(records).aside
    else:
        errors, data = [float(fit.rms[o]) for fit in fits], search.validation.data
        model, std = _final(search, final, data.finer or data, noted=False)
        aside = ASIDE
    history = [
        Step(row.added, error, remaining(fits[0], row.fit, search.validation), row.at)
        for row, error in zip(rows, errors, strict=True)
    ]
    output = list(search.best.model.outputs)[o]
    return Joined(model, history, _refused(every, steps), std, output, aside)


def _refused(every: Sequence[_Step], steps: Sequence[_Step]) -> list[str]:
    """The effects of all steps that are none of the accepted ones."""
    accepted = [key for key, _, _ in steps]
    return [key.effect for key, _, _ in every if key not in accepted]


def _that_hold(
    steps: Sequence[_Step],
    search: Search,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None,
) -> Sequence[_Step]:
    """All steps where they hold at the ends kept aside; else all but one effect, or the first of
    them.
    """
    subsets = _subsets([key for key, _, _ in steps])
    validated = [(subset, with_only(search, subset)) for subset in subsets]
    known = [(subset, fit.model) for subset, fit in validated if fit is not None]
    index = first_that_holds(
        search.base.model, [model for _, model in known], search, records, mapping
    )
    return [] if index is None else chain(search, known[index][0])


def _subsets(keys: Sequence[Key]) -> list[Sequence[Key]]:
    """All keys; all but one, without the last one first; then ever fewer of the first ones."""
    subsets = [
        keys,
        *([key for key in keys if key != out] for out in reversed(keys)),
        *(keys[:n] for n in range(len(keys) - 2, 0, -1)),
    ]
    return [
        subset for number, subset in enumerate(subsets) if subset and subset not in subsets[:number]
    ]


def _in_order(search: Search, keys: Sequence[Key]) -> list[_Step]:
    """Each effect with the structures before and after it."""
    steps, before = [], search.base
    for key in keys:
        after = with_only(search, (*before.keys, key))
        if after is None:
            raise NotIdentifiable(
                f"effect {key.effect!r} at {key.target!r}: the model diverges with it alone"
            )
        steps.append((key, before, after))
        before = after
    return steps


class _Row(NamedTuple):
    """What was added at which place, and the structure with it."""

    added: str | None
    at: str | None
    fit: ValidatedFit


def _before(search: Search, was: PhysicalModel) -> list[_Row]:
    """The model with values held that the base has free, judged like that, and the base once a
    value.
    """
    names = [
        name
        for name, p in was.parameters.items()
        if p.fixed and not search.base.model.parameters[name].fixed
    ]
    held = {**search.base.model.parameters, **{name: was.parameters[name] for name in names}}
    base = search.base.structure
    structure = Structure((), replace(base.model, parameters=held), base.states, base.steps)
    before = search.validation.validate(structure, steps=15, tolerance=1e-5)
    # what freeing takes away is no effect's: it has a line of its own in the history
    as_it_was = _Row(None, None, before or search.base)
    return [as_it_was, *(_Row(f"{name} freed", None, search.base) for name in names)]


def _on_the_rest(
    fits: Sequence[ValidatedFit],
    o: int,
    search: Search,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None,
) -> list[float]:
    """Errors of an output on the part that a user keeps aside."""
    hold = search.validation.data.experiments[0].hold
    testing = testing_of(search.base.model, split(records), mapping, hold)
    return [float(rmse_aside(fit.model, testing)[o]) for fit in fits]


def _every_sample(
    search: Search, records: Sequence[Record], mapping: Mapping[str, str] | None
) -> Data:
    """All records at the input timing of the search."""
    data = search.validation.data
    return data_of(*matched_at(data.model, records, mapping, data.experiments[0].hold))


def _final(
    search: Search, final: ValidatedFit, data: Data, *, noted: bool
) -> tuple[PhysicalModel, Mapping[str, float]]:
    """The model on all the data, and its standard deviations. One that nothing joins is estimated
    at its least simulation error over whole records, which a search in windows does not seek.
    """
    alone = None if final.keys else _estimated(final.model, data.experiments)
    if alone is not None:
        return alone.model, dict(zip(alone.parameters, alone.std.tolist(), strict=True))
    # a search on the part for training has not seen the rest, which the written model may learn
    # from
    whole = _on_everything(search, final, data) if noted else None
    if whole is not None:
        return whole.best.model, whole.validation.doubts(whole.best.structure)
    return final.model, search.validation.doubts(final.structure)


def _at_rest(
    joined: Joined, search: Search, records: Sequence[Record], mapping: Mapping[str, str] | None
) -> Joined | None:
    """The same structure estimated at its least simulation error over whole records; None where it
    diverges there.
    """
    hold = search.validation.data.experiments[0].hold
    least = _estimated(*matched_at(joined.model, records, mapping, hold))
    if least is None:
        return None
    std = dict(zip(least.parameters, least.std.tolist(), strict=True))
    return replace(joined, model=least.model, std={**joined.std, **std})


def _on_everything(search: Search, final: ValidatedFit, data: Data) -> Search | None:
    """The structure judged on all the data; None where it diverges there."""
    validation = replace(
        search.validation, data=data, last=data.horizon(search.validation.last.windows)
    )
    best = validation.validate(Structure(final.keys, final.model, {}, {}), steps=20, tolerance=1e-5)
    return None if best is None else replace(search, validation=validation, best=best)


def _estimated(model: PhysicalModel, experiments: Sequence[Experiment]) -> Estimate | None:
    try:
        return with_coloured_noise(estimate(model, experiments), experiments)
    except NotIdentifiable:
        return None


def _most_mended(search: Search) -> int:
    """The output whose error falls most."""
    # one that was not measured, or without any error, has no ratio
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = search.best.rms / search.base.rms
    return int(np.nanargmin(np.where(np.isfinite(ratio), ratio, np.inf)))


# The question.


@dataclass(frozen=True)
class Request:
    """What was asked of `improve`, but for the model, the records and what is to join."""

    mapping: Mapping[str, str] | None
    wanted: Wanted
    free: Sequence[str]
    seconds: float | None


@one_thread()
def improve(
    model: PhysicalModel,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None = None,
    *,
    add: Sequence[str] | None = None,
    effects: Sequence[str] | None = None,
    free: Sequence[str] | None = None,
    learned: bool = False,
    seconds: float | None = None,
    tell: Tell = untold,
) -> Improvement:
    """Add the effects `add` (id or id@target), or with None those that `explain` accepts, one after
    the other.

    Every block of the records is kept aside in turn, and what `explain` accepts joins as far as it
    simulates the end of the records, and of several the most different one, no worse. Where a user
    notes which part of a record is for training, effects are sought there, and their errors told on
    the rest. Effects that are asked for join whether they help or not.

    The returned model is re-estimated on everything. Where all that `explain` accepts would leave a
    larger error than the model as it was leaves, nothing joins (`refused` names it). Values that
    the model fixes stay, but for those named in `free`. The verdict is that of `compare` on the
    returned model: `adequate` where its error is not structured.

    Raises
    ------
    BadModel
        An effect that is not in the catalogue, does not fit the model, or fits several places and
        names none; a name in `free` that is no fixed parameter.
    BadRecord
        Records too short to keep parts of them aside.
    NotIdentifiable
        The model diverges on a record.
    """
    free = free or ()
    _check_fixed(model, free)
    wanted = Wanted(None if effects is None else tuple(effects), learned)
    how = Request(mapping, wanted, free, None if seconds is None else EXPLAINING_TIME * seconds)
    with at_most() as work:
        improvement = (
            _as_explained(model, records, how, tell)
            if add is None
            else _as_asked(model, records, add, how, tell)
        )
    return replace(improvement, work=work)


def _check_fixed(model: PhysicalModel, names: Sequence[str]) -> None:
    fixed = [name for name, p in model.parameters.items() if p.fixed]
    if unknown := [name for name in names if name not in fixed]:
        hint = known_names(unknown[0], fixed, "there are")
        raise BadModel(
            f"free {unknown[0]!r}: is no parameter that model {model.name!r} holds fixed; {hint}"
        )


def _as_explained(
    model: PhysicalModel, records: Sequence[Record], how: Request, tell: Tell
) -> Improvement:
    """The model with what `explain` accepts, without values that only it frees."""
    check_length(records)
    training, before = _training(records), freed(model, how.free)
    explanation = explained(
        before, training, how.mapping, how.wanted, how.seconds, part_of(tell, 0.0, 0.8)
    )
    search = explanation.found
    # what is found beside them as they are held
    if any(key.effect == HELD for key in search.best.keys):
        held = replace(how.wanted, held=False)
        before = _with_inputs_of(before, search.validation.data.model)
        search = searched(
            before, training, how.mapping, held, seconds=how.seconds, tell=part_of(tell, 0.8, 0.9)
        )
    tell(0.9, "estimating on everything")
    joined = joined_of(search, records, how.mapping, was=model if how.free else None)
    improvement = _improvement(model, records, joined, how, explanation)
    if improvement.verdict == "adequate" or not improvement.added:
        return improvement
    # Whether something is left is asked of whole records, and a search in windows, or one that ends
    # where blocks are told apart, stops a few standard deviations short of the least error there.
    rested = _at_rest(joined, search, records, how.mapping)
    again = None if rested is None else _improvement(model, records, rested, how, explanation)
    return improvement if again is None or again.verdict != "adequate" else again


def _as_asked(
    model: PhysicalModel, records: Sequence[Record], ids: Sequence[str], how: Request, tell: Tell
) -> Improvement:
    """The model with all the effects that a user names."""
    knowing = _with_columns_of(model, records, ids)
    keys = [_resolved(knowing, id) for id in ids]
    data = matched(freed(knowing, how.free), _training(records), how.mapping)
    search = at_its_rate(data, partial(with_asked, keys=keys, tell=part_of(tell, 0.0, 0.9)))
    tell(0.9, "estimating on everything")
    joined = joined_of(search, records, how.mapping, asked=keys, was=model if how.free else None)
    return _improvement(model, records, joined, how)


def _training(records: Sequence[Record]) -> Sequence[Record]:
    """The part that a user notes as for training, else everything."""
    return split(records).training if is_noted(records) else records


def _improvement(
    model: PhysicalModel,
    records: Sequence[Record],
    joined: Joined,
    how: Request,
    explanation: Explanation | None = None,
) -> Improvement:
    """The improvement by what an explanation found, or else by what was asked for."""
    unit = joined.model.outputs[joined.output].unit
    improved = with_provenance(
        joined.model, joined.std, records, joined.history, joined.output, unit
    )
    improved, history = without_idle(improved, model), tuple(joined.history)
    if explanation is None:
        verdict = "improved" if history[-1].error < history[0].error else "not-improved"
    else:
        # that of the model as it will be written
        left = leaves_something(improved, records, how.mapping)
        verdict = "unknown-effect" if left else "adequate"
    return Improvement(
        improved,
        history,
        verdict,
        joined.output,
        unit,
        explanation,
        joined.aside,
        tuple(joined.refused),
    )


def _with_inputs_of(model: PhysicalModel, knowing: PhysicalModel) -> PhysicalModel:
    """The model with the inputs that another one knows besides."""
    for name, signal in knowing.inputs.items():
        model = model.with_input(name, signal.unit)
    return model


def _with_columns_of(
    model: PhysicalModel, records: Sequence[Record], ids: Sequence[str]
) -> PhysicalModel:
    """The model with those columns of the records among its inputs that a forgotten input is to be
    tied to.
    """
    for name in [n for id in ids for n in tied_to(id) if takes_columns(_parts(id)[0])]:
        if name not in model.inputs and all(name in record.names for record in records):
            model = model.with_input(name, records[0].units.get(name, ""))
    return model


def _parts(id: str) -> Key:
    """Effect and target of `id@target` or `id:target`; no target where none is said."""
    name, _, target = id.replace(":", "@", 1).partition("@")
    return Key(name, target)


def _resolved(model: PhysicalModel, id: str) -> Key:
    name, target = _parts(id)
    if target:
        # For its refusal of a place that the effect does not fit.
        model.with_effect(name, target)
        return Key(name, target)
    key, *more = fitting(model, name)
    if more:
        places = ", ".join(place.target for place in (key, *more))
        raise BadModel(f"effect {name!r}: fits {places}; say which, as {name}@{key.target}")
    return key
