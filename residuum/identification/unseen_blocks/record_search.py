"""The search in records: at a lower rate first where that loses nothing, with inputs that a model
may have forgotten, and with effects that a user asks for in the place of a search.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING

from residuum.identification.errors import NotIdentifiable
from residuum.identification.physics import Key, PhysicalModel, match
from residuum.identification.physics.model import fitting, takes_columns
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.data import Data, coarser, data_of, long_enough, matched
from residuum.identification.unseen_blocks.following import followed
from residuum.identification.unseen_blocks.multiple_shooting import (
    first_fit,
    first_fit_at_likelier_timing,
)
from residuum.identification.unseen_blocks.policy import MOST_EFFORT
from residuum.identification.unseen_blocks.proposals import forgotten_columns
from residuum.identification.unseen_blocks.search import next_beam, search
from residuum.identification.unseen_blocks.structure import Structure
from residuum.identification.unseen_blocks.trial_fits import full_fit, quick_fit, refined
from residuum.identification.unseen_blocks.tried import (
    Search,
    Wanted,
    at_the_timing_it_suits,
    begun,
)
from residuum.identification.work import OutOfWork, Tell, at_most, left_out, rising, untold

if TYPE_CHECKING:
    from residuum.identification.unseen_blocks.cross_validation import ValidatedFit


def searched(
    model: PhysicalModel,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None,
    wanted: Wanted,
    *,
    seconds: float | None = None,
    tell: Tell = untold,
) -> Search:
    """The search for what records show that a model lacks; in noise, at the rate of the records.

    It is the model as it is alone where the work, or the seconds that a user gave, are over before
    anything else is known.

    Raises
    ------
    BadRecord, BadUnit
        Columns that do not fit the model, records too short for blocks.
    NotIdentifiable
        The model diverges on a record.
    """
    data = matched(model, records, mapping)
    try:
        with at_most(MOST_EFFORT, seconds):
            return at_its_rate(data, partial(search, wanted=wanted, tell=rising(tell)))
    except OutOfWork:
        left_out("everything beside the model as it is")
        return begun(first_fit(coarser(data)))


def at_its_rate(data: Data, seek: Callable[[Data], Search]) -> Search:
    """What is sought in data, at a lower rate that loses nothing; in noise, where every sample
    counts, at their own.
    """
    outcome = seek(coarser(data))
    # those of the outcome: a search may have turned the input timing
    finer = outcome.validation.data.finer
    if not outcome.validation.scale.nats or finer is None:
        return outcome
    try:
        return seek(finer)
    except OutOfWork:
        left_out("the samples between those of a lower rate")
        return outcome


# Inputs that a model may have forgotten: spare columns of the records, taken up before anything is
# searched.


def _check_fitting(model: PhysicalModel, wanted: Wanted) -> None:
    """BadModel for an effect that was asked for, is not in the model, and can act nowhere in it,
    whatever columns there are.
    """
    present = {use.id for use in model.effects}
    for id in wanted.effects or ():
        if id not in present and not takes_columns(id):
            fitting(model, id)


def with_forgotten_inputs(
    model: PhysicalModel,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None,
    wanted: Wanted,
) -> PhysicalModel:
    """The model with those spare columns as idle inputs that what a balance lacks resembles.

    Nothing is known of that where the records are short, or where neither the model nor its filter
    follows them.
    """
    may_be_forgotten = wanted.effects is None or any(takes_columns(id) for id in wanted.effects)
    matched_model, experiments = match(model, records, mapping)
    _check_fitting(matched_model, wanted)
    has_spare = any(e.spare for e in experiments)
    if not (may_be_forgotten and has_spare and long_enough([e.n for e in experiments])):
        return model
    for name in _forgotten(data_of(matched_model, experiments)):
        model = model.with_input(name, experiments[0].spare[name].unit)
    return model


def _forgotten(data: Data) -> list[str]:
    """Spare columns that what a balance lacks resembles; none where nothing follows the data."""
    try:
        along = followed(first_fit_at_likelier_timing(data).structure.model, data)
    except NotIdentifiable:
        return []
    return [] if along is None else forgotten_columns(data.model, along)


# Effects that a user asks for: each joins the model, real or not, from where it promises most.


def with_asked(
    data: Data, keys: Sequence[Key], tell: Tell = untold, *, turn: bool = True
) -> Search:
    """The data's model with these effects, one after the other, at the likelier input timing where
    it may be turned.

    Raises
    ------
    NotIdentifiable
        The model diverges on the records, as it is or with one of the effects.
    """
    tell(0.0, "estimating the model as it is")
    outcome = begun(first_fit_at_likelier_timing(data) if turn else first_fit(data))
    for number, key in enumerate(keys):
        tell(0.1 + 0.8 * number / len(keys), f"adding {key.effect} to {key.target}")
        after = _joined(outcome, key)
        if after is None:
            raise NotIdentifiable(
                f"effect {key.effect!r} at {key.target!r}: the model diverges with it; start from"
                " other values, or leave it out"
            )
        outcome.best, outcome.every[after.keys] = after, after
        retimed = at_the_timing_it_suits(outcome) if turn else None
        if retimed is not None:
            return with_asked(retimed, keys, tell, turn=False)
        next_beam(outcome, [after])
    return outcome


def _joined(outcome: Search, key: Key) -> ValidatedFit | None:
    """The best structure with one effect more; None where it diverges from all first values."""
    parent, validation = outcome.best, outcome.validation
    along = followed(parent.model, validation.data, parent.errors, validation.last)
    if along is None:
        return None
    given = None if parent.keys else followed(validation.data.model, validation.data)
    first_steps = quick_fit(parent.structure, key, along, validation, given)
    if first_steps is None:
        return None
    near = refined(first_steps)
    lowest = min((fits[0] for fits in near.fits.values()), key=lambda fit: fit.mean)
    # the user asks for the effect: values that a search would refuse do not keep it out
    structure = Structure(near.keys, lowest.model, parent.structure.states, parent.structure.steps)
    return full_fit(near, validation) or validation.validate(structure, steps=15, tolerance=1e-5)
