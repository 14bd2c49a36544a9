"""Where an improvement begins: the model on the training data, and the effects that are to join it, found or asked for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from residuum.identification.discrepancy.exact_structure import Exact
from residuum.identification.discrepancy.explain import explained
from residuum.identification.discrepancy.explanation import Explanation
from residuum.identification.discrepancy.fitting.judged_experiments import experiments_and_base
from residuum.identification.discrepancy.fitting.structure_fits import fit_structure
from residuum.identification.discrepancy.fitting.structures import Structure
from residuum.identification.discrepancy.improving.held_out import Split
from residuum.identification.discrepancy.judging.experiments_to_blame import at_turned_timing
from residuum.identification.errors import BadModel
from residuum.identification.physics import Experiment, Key, PhysicalModel, candidates
from residuum.identification.physics.model import find_effect, tied_to
from residuum.identification.record import Record
from residuum.identification.residual_analysis.input_timing import turned_timing
from residuum.identification.unseen_blocks.held_value import freed
from residuum.identification.unseen_blocks.tried import Wanted
from residuum.identification.work import Tell, part_of


@dataclass(frozen=True)
class Request:
    """What was asked of `improve`, but for the model, the records and what is kept aside of them."""

    mapping: Mapping[str, str] | None
    add: Sequence[str] | None
    effects: Sequence[str] | None
    free: Sequence[str]
    learned: bool
    seconds: float | None


@dataclass(frozen=True, eq=False)
class Beginning:
    """The training data, the model as it was on them, the base that effects join, what the search for an exact structure found,
    where one was, and the effects chosen.
    """

    experiments: list[Experiment]
    as_it_was: Structure
    base: Structure
    exact: Exact | None
    chosen: list[Key]


def asked_for(model: PhysicalModel, records: Sequence[Record], parts: Split, how: Request, ids: Sequence[str]) -> Beginning:
    """The base, and the effects that the user names."""
    model = _with_columns_of(model, records, ids)
    chosen = [_resolved(model, id) for id in ids]
    experiments, base = experiments_and_base(model, parts.training, how.mapping)
    return Beginning(experiments, base, _with_free(base, how.free, experiments), None, chosen)


def named(model: PhysicalModel, records: Sequence[Record], parts: Split, how: Request, tell: Tell) -> Explanation:
    """What `explain` says of all records; where a user notes which part is for training, of that."""
    wanted = Wanted(None if how.effects is None else tuple(how.effects), how.learned)
    asked = parts.training if any(record.split is not None for record in records) else records
    return explained(freed(model, how.free), asked, how.mapping, wanted, how.seconds, part_of(tell, 0.1, 0.6))


def begun_exactly(model: PhysicalModel, parts: Split, how: Request, exact: Exact) -> Beginning:
    """The base on the training data, at the input timing that the search for an exact structure settled on, and the effects that
    it accepts.
    """
    search, like, chosen = exact.found, exact.experiments, [*exact.found.accepted, *exact.found.timing]
    if turned := at_turned_timing(search, like):
        like, chosen = turned[0], list(search.accepted)
    knowing = with_inputs_of(model, search.base.model)
    experiments, as_it_was = experiments_and_base(knowing, parts.training, how.mapping, exact.finer)
    if not np.array_equal(experiments[0].hold, like[0].hold):
        experiments = turned_timing(experiments)
        as_it_was = fit_structure(as_it_was.model, experiments, as_it_was.initial) or as_it_was
    return Beginning(experiments, as_it_was, _with_free(as_it_was, how.free, experiments), exact, chosen)


def with_inputs_of(model: PhysicalModel, knowing: PhysicalModel) -> PhysicalModel:
    """The model with the inputs that another one knows besides."""
    for name, signal in knowing.inputs.items():
        model = model.with_input(name, signal.unit)
    return model


def _with_free(base: Structure, names: Sequence[str], experiments: Sequence[Experiment]) -> Structure:
    return (fit_structure(freed(base.model, names), experiments, base.initial) if names else None) or base


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
    fitting = [t for _, t in candidates(model, [name])]
    if target:
        model.with_effect(name, target)
        return Key(name, target)
    if not fitting:
        raise BadModel(f"effect {name!r}: fits no balance, input or output of model {model.name!r}, or is in it already")
    if len(fitting) > 1:
        raise BadModel(f"effect {name!r}: fits {', '.join(fitting)}; say which, as {name}@{fitting[0]}")
    return Key(name, fitting[0])
