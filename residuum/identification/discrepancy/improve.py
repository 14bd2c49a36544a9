"""Improve: add effects to a model, re-estimate it, and count the error on data that were not used for it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

from residuum.identification.blas_threads import one_thread
from residuum.identification.discrepancy.explain import check_length, explained
from residuum.identification.discrepancy.explanation import Explanation
from residuum.identification.discrepancy.improvement import Improvement, with_provenance
from residuum.identification.discrepancy.joined import Joined, joined_of
from residuum.identification.discrepancy.kept_aside import is_noted, split
from residuum.identification.discrepancy.policy import EXPLAINING_TIME
from residuum.identification.errors import BadModel
from residuum.identification.physics import Key, PhysicalModel
from residuum.identification.physics.model import find_effect, fitting, tied_to
from residuum.identification.record import Record
from residuum.identification.residual_analysis.compare import compare
from residuum.identification.unseen_blocks.asked import with_asked
from residuum.identification.unseen_blocks.at_its_rate import at_its_rate, searched
from residuum.identification.unseen_blocks.data import matched
from residuum.identification.unseen_blocks.held_value import HELD, freed
from residuum.identification.unseen_blocks.proposals import without_idle
from residuum.identification.unseen_blocks.tried import Wanted
from residuum.identification.work import Tell, at_most, part_of, untold
from residuum.nearest_names import known_names


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
    """Add the effects `add` (id or id@target), or with None those that `explain` accepts, one after the other.

    Every block of the records is kept aside in turn, and what `explain` accepts joins as far as it simulates the end of the
    records, and of several the most different one, no worse. Where a user notes which part of a record is for training, effects
    are sought there, and their errors told on the rest. Effects that are asked for join whether they help or not.

    The returned model is re-estimated on everything. Where all that `explain` accepts would leave a larger error than the model
    as it was leaves, nothing joins (`refused` names it). Values that the model fixes stay, but for those named in `free`. The
    verdict is that of `compare` on the returned model: `adequate` where its error is not structured.

    Raises
    ------
    BadModel
        An effect that is not in the catalogue, does not fit the model, or fits several places and names none; a name in `free`
        that is no fixed parameter.
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
        found = _as_explained(model, records, how, tell) if add is None else _as_asked(model, records, add, how, tell)
    return replace(found, work=work)


def _check_fixed(model: PhysicalModel, names: Sequence[str]) -> None:
    fixed = [name for name, p in model.parameters.items() if p.fixed]
    if unknown := [name for name in names if name not in fixed]:
        there = known_names(unknown[0], fixed, "there are")
        raise BadModel(f"free {unknown[0]!r}: is no parameter that model {model.name!r} holds fixed; {there}")


def _as_explained(model: PhysicalModel, records: Sequence[Record], how: Request, tell: Tell) -> Improvement:
    """The model with what `explain` accepts, without values that only it frees."""
    check_length(records)
    training, before = _training(records), freed(model, how.free)
    said = explained(before, training, how.mapping, how.wanted, how.seconds, part_of(tell, 0.0, 0.8))
    found = said.found
    if any(key.effect == HELD for key in found.best.keys):  # what is found beside them as they are held
        held = replace(how.wanted, held=False)
        before = _with_inputs_of(before, found.court.data.model)
        found = searched(before, training, how.mapping, held, seconds=how.seconds, tell=part_of(tell, 0.8, 0.9))
    tell(0.9, "estimating on everything")
    joined = joined_of(found, records, how.mapping, was=model if how.free else None)
    return _improvement(model, records, joined, how, said)


def _as_asked(model: PhysicalModel, records: Sequence[Record], ids: Sequence[str], how: Request, tell: Tell) -> Improvement:
    """The model with all the effects that a user names."""
    knowing = _with_columns_of(model, records, ids)
    keys = [_resolved(knowing, id) for id in ids]
    data = matched(freed(knowing, how.free), _training(records), how.mapping)
    found = at_its_rate(data, partial(with_asked, keys=keys, tell=part_of(tell, 0.0, 0.9)))
    tell(0.9, "estimating on everything")
    joined = joined_of(found, records, how.mapping, asked=keys, was=model if how.free else None)
    return _improvement(model, records, joined, how)


def _training(records: Sequence[Record]) -> Sequence[Record]:
    """The part that a user notes as for training, else everything."""
    return split(records).training if is_noted(records) else records


def _improvement(
    model: PhysicalModel, records: Sequence[Record], joined: Joined, how: Request, said: Explanation | None = None
) -> Improvement:
    """The improvement by what was `said`, or else asked for."""
    unit = joined.model.outputs[joined.output].unit
    improved = with_provenance(joined.model, joined.std, records, joined.history, joined.output, unit)
    improved, history = without_idle(improved, model), tuple(joined.history)
    if said is None:
        verdict = "improved" if history[-1].error < history[0].error else "not-improved"
    else:
        verdict = _verdict(improved, records, how.mapping)
    return Improvement(improved, history, verdict, joined.output, unit, said, joined.aside, tuple(joined.refused))


def _verdict(improved: PhysicalModel, records: Sequence[Record], mapping: Mapping[str, str] | None) -> str:
    """That of `compare` on the model as it will be written: `adequate`, or what is left has no name."""
    return "unknown-effect" if compare(improved, records, mapping, refuse_unstable=False).present else "adequate"


def _with_inputs_of(model: PhysicalModel, knowing: PhysicalModel) -> PhysicalModel:
    """The model with the inputs that another one knows besides."""
    for name, signal in knowing.inputs.items():
        model = model.with_input(name, signal.unit)
    return model


def _with_columns_of(model: PhysicalModel, records: Sequence[Record], ids: Sequence[str]) -> PhysicalModel:
    """The model with those columns of the records among its inputs that a forgotten input is to be tied to."""
    for name in [n for id in ids for n in tied_to(id) if find_effect(_parts(id)[0]).takes_columns]:
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
        model.with_effect(name, target)
        return Key(name, target)
    key, *more = fitting(model, name)
    if more:
        places = ", ".join(each.target for each in (key, *more))
        raise BadModel(f"effect {name!r}: fits {places}; say which, as {name}@{key.target}")
    return key
