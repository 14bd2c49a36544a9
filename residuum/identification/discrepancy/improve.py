"""Improve: add effects to a model, re-estimate it, and count the error on data that were not used for it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from residuum.identification.blas_threads import one_thread
from residuum.identification.discrepancy.data import Data, matched
from residuum.identification.discrepancy.explain import Explanation, doubts_of, explain, remaining
from residuum.identification.discrepancy.following import followed
from residuum.identification.discrepancy.improvement import Improvement, Step, with_provenance
from residuum.identification.discrepancy.judged import Judged
from residuum.identification.discrepancy.kept_aside import Split, error_on, split
from residuum.identification.discrepancy.ladder import climb_at_likelier_timing
from residuum.identification.discrepancy.looks import Court, glance, look
from residuum.identification.discrepancy.proposals import HELD, freed, without_idle
from residuum.identification.discrepancy.search import Search, Tell, Wanted, begun, chain, untold
from residuum.identification.discrepancy.structure import fitted
from residuum.identification.errors import BadModel, NotIdentifiable
from residuum.identification.physics import Key, PhysicalModel, candidates
from residuum.identification.physics.model import find_effect, tied_to
from residuum.identification.record import Record
from residuum.identification.residual_analysis.compare import compare
from residuum.identification.work import Work, at_most

Array = npt.NDArray[np.float64]
Found = list[tuple[str | None, Judged]]
"""What was added (None: the model as it was), and the structure then."""


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
    """Add the effects `add` (id or id@target), or with None those that `explain` names.

    The errors of the history are those on data that the estimate has not seen: every block in turn, or what is kept aside of
    several records or by a record's note. Values that the model fixes stay, but for those named in `free`. Where the error does
    not fall, what `explain` names does not join, and the model is returned as it was. The verdict is that of `compare` on the
    returned model, `improved` or `not-improved` where the effects were asked for.

    Raises
    ------
    BadModel
        An effect that is not in the catalogue, does not fit the model, or fits several places and names none; a name in `free`
        that is no fixed parameter.
    NotIdentifiable
        The model diverges on a record.
    """
    _check_fixed(model, free)
    for id in add or ():
        find_effect(_parts(id).effect)
    parts, start = split(records), freed(model, free)
    with at_most() as work:
        if add is None:
            how = Wanted(None if effects is None else tuple(effects), learned)
            start_from = _named(start, parts, mapping, how, seconds, lambda share, doing: tell(0.8 * share, doing))
        else:
            start_from = _asked(_with_columns_of(start, records, add), parts, mapping, add)
        tell(0.85, "estimating on everything")
        found = start_from.found
        first = f"{' and '.join(free)} freed" if free else None
        steps: Found = [(first, found.base), *((key.effect, one) for key, one in start_from.joined)]
        if free:
            steps = [(None, _as_it_was(model, found, parts, mapping)), *steps]
        improved = _answer(model, records, mapping, start_from, steps, parts)
    return replace(improved, work=work)


@dataclass(frozen=True, eq=False)
class _Begun:
    """What was searched or asked for, the effects that join one after the other, and what `explain` says, where it was asked."""

    found: Search
    joined: list[tuple[Key, Judged]]
    explanation: Explanation | None


def _named(
    model: PhysicalModel, parts: Split, mapping: Mapping[str, str] | None, how: Wanted, seconds: float | None, tell: Tell
) -> _Begun:
    """The effects that `explain` names; where it frees values that the model holds, beside those as they are held."""
    said = explain(model, parts.training, mapping, effects=how.effects, learned=how.learned, seconds=seconds, tell=tell)
    found = said.search
    keys = [key for key in found.best.keys if key.effect != HELD]
    if said.held:
        found = _joined(found.court.data, keys)
    return _Begun(found, [(key, after) for key, _, after in chain(found, keys)], said)


def _asked(model: PhysicalModel, parts: Split, mapping: Mapping[str, str] | None, ids: Sequence[str]) -> _Begun:
    """The effects that the user names, in this order, whatever they do."""
    keys = [_resolved(model, id) for id in ids]
    found = _joined(matched(model, parts.training, mapping), keys)
    return _Begun(found, [(key, found.every[tuple(sorted(keys[: k + 1]))]) for k, key in enumerate(keys)], None)


def _answer(
    model: PhysicalModel,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None,
    start_from: _Begun,
    steps: Found,
    parts: Split,
) -> Improvement:
    found, asked = start_from.found, start_from.explanation is None
    hold = found.court.data.experiments[0].hold
    errors = [error_on(one.model, parts, mapping, hold) if parts.testing else one.rms for _, one in steps]
    o = _output(errors)
    output = list(found.base.model.outputs.values())[o]
    history = [
        Step(name, float(error[o]), None if parts.testing else remaining(_led_by(found, one)))
        for (name, one), error in zip(steps, errors, strict=True)
    ]
    fell = history[-1].error < history[0].error
    if not (fell or asked):
        history, steps = history[:1], steps[:1]
    better = _estimated(steps[-1][1], found, records, mapping, parts)
    improved = with_provenance(better.model, doubts_of(_led_by(found, better)), records, history, output.name, output.unit)
    improved = without_idle(improved, model)
    if asked:
        verdict = "improved" if fell else "not-improved"
    else:
        verdict = "unknown-effect" if compare(improved, records, mapping).present else "adequate"
    return Improvement(improved, tuple(history), verdict, output.name, output.unit, start_from.explanation, parts.aside, Work())


def _led_by(found: Search, best: Judged) -> Search:
    """What was found, with another structure as the best."""
    return Search(found.court, found.base, best, found.along, found.every, [], found.tried)


def _output(errors: Sequence[Array]) -> int:
    """The output whose error falls most."""
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = errors[-1] / errors[0]
    return int(np.nanargmin(np.where(np.isfinite(ratio), ratio, np.inf)))


def _joined(data: Data, keys: Iterable[Key]) -> Search:
    """The effects joined one after the other, whatever they do."""
    found = begun(climb_at_likelier_timing(data))
    for key in keys:
        parent = found.best
        along = followed(parent.model, found.court.data, parent.errors, found.court.last)
        seen = None if along is None else glance(parent.structure, key, along, found.court)
        one = None if seen is None else look(seen, found.court, any_value=True)
        if one is None:
            raise NotIdentifiable(f"effect {key.effect!r} at {key.target!r}: the model diverges with it")
        found.every[one.keys] = one
        found.best = one
    return found


def _as_it_was(model: PhysicalModel, found: Search, parts: Split, mapping: Mapping[str, str] | None) -> Judged:
    """The model with its values held, judged as what was found is."""
    data = replace(found.court.data, model=matched(model, parts.training, mapping).model)
    structure = replace(found.base.structure, model=data.model)
    court = Court(data, found.court.last, found.court.middle, found.court.scale)
    one = court.judge(structure, steps=20, tolerance=1e-5)
    return found.base if one is None else one


def _estimated(one: Judged, found: Search, records: Sequence[Record], mapping: Mapping[str, str] | None, parts: Split) -> Judged:
    """The structure estimated on everything."""
    if not parts.testing:
        return one
    court = found.court
    everything = matched(one.model, records, mapping)
    everything = replace(
        everything, experiments=[replace(e, hold=court.data.experiments[0].hold) for e in everything.experiments]
    )
    rung = (
        everything.rung(court.last.windows)
        if any(r.windows == court.last.windows for r in everything.rungs)
        else everything.rungs[-1]
    )
    again = Court(everything, rung, rung, court.scale)
    estimate = fitted(one.model, rung.parts, None, court.scale, steps=20, tolerance=1e-6)
    if estimate is None:
        return one
    judged = again.judge(one.structure.at(rung, estimate), steps=3, tolerance=1e-6)
    return one if judged is None else judged


def _check_fixed(model: PhysicalModel, names: Sequence[str]) -> None:
    fixed = [name for name, p in model.parameters.items() if p.fixed]
    if unknown := [name for name in names if name not in fixed]:
        there = ", ".join(fixed) or "none"
        raise BadModel(f"free {unknown[0]!r}: is no parameter that model {model.name!r} holds fixed; there are {there}")


def _with_columns_of(model: PhysicalModel, records: Sequence[Record], ids: Sequence[str]) -> PhysicalModel:
    """The model with those columns of the records among its inputs that a forgotten input is to be tied to."""
    for name in [n for id in ids for n in tied_to(id) if find_effect(_parts(id).effect).takes_columns]:
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
