"""Inputs that a model may have forgotten: spare columns of the records, taken up before anything is
searched.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from residuum.identification.errors import NotIdentifiable
from residuum.identification.physics import PhysicalModel, match
from residuum.identification.physics.model import fitting, takes_columns
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.data import data_of, long_enough
from residuum.identification.unseen_blocks.following import followed
from residuum.identification.unseen_blocks.ladder import climb_at_likelier_timing
from residuum.identification.unseen_blocks.proposals import forgotten_columns
from residuum.identification.unseen_blocks.tried import Wanted


def _check_fitting(model: PhysicalModel, wanted: Wanted) -> None:
    """BadModel for an effect that was asked for, is not in the model, and can act nowhere in it,
    whatever columns there are.
    """
    present = {use.id for use in model.effects}
    for id in wanted.effects or ():
        if id not in present and not takes_columns(id):
            fitting(model, id)


def informed(
    model: PhysicalModel,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None,
    wanted: Wanted,
) -> PhysicalModel:
    """The model with those spare columns as idle inputs that what a balance lacks resembles.

    Nothing is known of that where the records are short, or where neither the model nor its filter
    follows them.
    """
    asked = wanted.effects is None or any(takes_columns(id) for id in wanted.effects)
    matched, experiments = match(model, records, mapping)
    _check_fitting(matched, wanted)
    if not (asked and any(e.spare for e in experiments)) or not long_enough(
        [e.n for e in experiments]
    ):
        return model
    data = data_of(matched, experiments)
    try:
        along = followed(climb_at_likelier_timing(data).structure.model, data)
    except NotIdentifiable:
        return model
    if along is not None:
        for name in forgotten_columns(data.model, along):
            model = model.with_input(name, experiments[0].spare[name].unit)
    return model
