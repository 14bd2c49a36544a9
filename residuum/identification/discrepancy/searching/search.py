"""Forward–backward search over structures: which effects, together, the data want in the model."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import count

import numpy as np

from residuum.identification.discrepancy.fitting.drifting_load import likeliest_drifting_load
from residuum.identification.discrepancy.fitting.structure_comparison import mean_ratio, schwarz
from residuum.identification.discrepancy.fitting.structure_fits import base_structure, fit_structure, refit
from residuum.identification.discrepancy.fitting.structures import Structure, times_its_innovations
from residuum.identification.discrepancy.policy.acceptance import ACCEPT, ACCEPT_MORE, DRIFT_SHARE
from residuum.identification.discrepancy.policy.trials import (
    FEWEST_REFITS,
    HALF_THE_ERROR,
    MOST_EFFECTS,
    NEAR,
    NEARLY_ALL,
    STRAYED,
)
from residuum.identification.discrepancy.screening.score_test import Screen
from residuum.identification.discrepancy.screening.shooting import effects_by_shooting, pairs_by_shooting
from residuum.identification.discrepancy.searching.evidence import preferred, tempered_gain
from residuum.identification.discrepancy.searching.exchange import exchange_all, settle, with_two
from residuum.identification.discrepancy.searching.growth import grow
from residuum.identification.discrepancy.searching.holding_up import holds_up
from residuum.identification.discrepancy.searching.looks import Task, strayed
from residuum.identification.discrepancy.searching.search_state import Asked, Search, evidence_asked, never
from residuum.identification.discrepancy.searching.trials import polished
from residuum.identification.errors import NotIdentifiable
from residuum.identification.physics import Experiment, Key, PhysicalModel
from residuum.identification.residual_analysis.policy.noise import MUCH_LEFT, SLOW
from residuum.identification.side_by_side import beside, side_by_side
from residuum.identification.work import Tell, untold


def search(
    base: Structure,
    experiments: Sequence[Experiment],
    *,
    nominal: PhysicalModel | None = None,
    effects: Iterable[str] | None = None,
    refits: int = FEWEST_REFITS,
    most_effects: int = MOST_EFFECTS,
    leave: Asked = never,
    late: Asked = never,
    tell: Tell = untold,
) -> Search:
    """Add the best effect, again and again while the evidence wants one more.

    At each step all candidates are screened to first order on top of what was found so far, the best `refits` are
    re-estimated in full with the noise colour of their own, and the winner is accepted when its evidence exceeds
    log(number of candidates) + `ACCEPT`.

    Where noise that drifts explains more, with no effect at all, than everything that was found, or where what was found leaves a
    slow error and is not wanted beside noise that drifts, the search is done again with noise that may drift: a load that walks
    at random resembles every effect that has a mean. So it is where a load of every window's own explains more.

    Where the base could only be fitted far from the values of `nominal` (an inertia without end, so that a torque which lacks
    a large term does nothing), nothing can be added there; the search is first done from near those values.

    What has grown is judged again, and where it leaves much sought from other beginnings and over short stretches, unless who
    asked knows that the experiments are to blame: `leave` is asked of what has grown, `late` of every shift in time besides.

    How many looks at the catalogue it takes nobody knows before: `tell` hears a share that each brings nearer to all.
    """
    wanted, looks = None if effects is None else tuple(effects), count()
    task = Task(experiments, nominal, wanted, refits, most_effects, lambda doing: tell(1.0 - 0.8 ** next(looks), doing))
    drifting = beside(lambda: fit_structure(base.model, experiments, base.initial, drifting=True))
    near = None if nominal is None else _near(nominal, base, experiments)
    if near is not None:
        found = _forward(near, task, leave, late)
        if found.accepted and found.best.log_likelihood > base.log_likelihood + ACCEPT + np.log(found.count):
            return found
    found = _forward(base, task, leave, late)
    if found.accepted or found.refuted:
        drift = drifting()
        if drift is not None and _does_as_well(drift, found, experiments):
            return _forward(drift, task, leave, late)
    load = likeliest_drifting_load(base, experiments)
    return _forward(load, task, leave, late) if load is not None and _outdoes(load, found) else found


def _does_as_well(drift: Structure, found: Search, experiments: Sequence[Experiment]) -> bool:
    """Whether noise that drifts explains what was found."""
    if drift.log_likelihood > found.best.log_likelihood + ACCEPT:
        return True
    if times_its_innovations(found.best) <= SLOW:
        return False
    beside = fit_structure(found.best.model, experiments, found.best.initial, drifting=True)
    return beside is None or tempered_gain(beside, drift) - beside.penalty(drift) < evidence_asked(found, ACCEPT)


def _outdoes(load: Structure, found: Search) -> bool:
    """Whether a load of every window's own is likelier than what was found, and leaves far less of the error.

    Little less it leaves where it makes up for what an effect, or the integration of its input, does not follow exactly.
    """
    likelier = schwarz(load, found.base) > schwarz(found.best, found.base) + evidence_asked(found, ACCEPT)
    return likelier and mean_ratio(load.rmse, found.best.rmse) < DRIFT_SHARE


def _near(nominal: PhysicalModel, base: Structure, experiments: Sequence[Experiment]) -> Structure | None:
    """The base fitted within `NEAR` of the nominal values; None where it lies within a few times that anyway, or diverges."""
    if not strayed(nominal, base, STRAYED):
        return None
    values = {n: p.value for n, p in nominal.parameters.items() if n in base.parameters and p.value != 0.0}
    narrowed = dict(nominal.parameters)
    for n, value in values.items():
        low, high = sorted((value / NEAR, value * NEAR))
        p = narrowed[n]
        narrowed[n] = replace(p, lower=max(low, p.lower), upper=min(high, p.upper))
    try:
        return base_structure(replace(nominal, parameters=narrowed), experiments)
    except NotIdentifiable:
        return None


def _forward(base: Structure, task: Task, leave: Asked, late: Asked) -> Search:
    found = Search(base, base, len(task.candidates(base)))
    grow(found, task, late)
    if leave(found) or late(found):
        return found
    first = dict(found.alternatives[0]) if found.alternatives else {}
    settle(found, task)
    for _ in range(task.most_effects):
        if not _shot_besides(found, task):
            break
        grow(found, task)
        exchange_all(found, task, found.accepted[-1:])
    if times_its_innovations(found.base) <= SLOW or _do_nearly_all(found, 1):
        return found
    return _begun_otherwise(found, first, task)


def _begun_otherwise(found: Search, first: dict[Key, Structure], task: Task) -> Search:
    """The search, or another one that begins with two effects or with another `first` one and does more."""
    if not _do_nearly_all(found, 2):
        other = _begun_with_two(found, task)
        found = other if other is not None and _does_more(other, found) else found
    for key in _other_beginnings(found, first):
        if _do_nearly_all(found, 2):
            break
        another = _begun_with(key, found, first, task)
        found = another if _does_more(another, found) else found
    return found


def _do_nearly_all(found: Search, effects: int) -> bool:
    """Whether so many effects were accepted and leave little more than noise."""
    if len(found.accepted) != effects:
        return False
    far, left = times_its_innovations(found.base), times_its_innovations(found.best)
    return bool(np.log(left) < NEARLY_ALL * np.log(far))


def _does_more(other: Search, found: Search) -> bool:
    """Whether the other search ended higher; against nothing at all several effects count only as far as each is wanted."""
    if found.accepted:
        return schwarz(other.best, found.base) > schwarz(found.best, found.base)
    gain = tempered_gain(other.best, found.base) - other.best.penalty(found.base)
    return len(other.accepted) > 1 and gain > evidence_asked(found, ACCEPT_MORE)


def _other_beginnings(found: Search, first: dict[Key, Structure]) -> list[Key]:
    """Of its first candidates those that a search may also begin with. One is the likeliest that it does not have and did not
    refuse, the other leaves least of the error.

    Where a base is far off, the first best may lead astray, and where two effects are missing neither may be enough alone, nor
    hold up without the other. What is slow the noise swallows, so that the likelihood hardly sees it go.
    """
    others = {key: s for key, s in first.items() if key not in (*found.accepted, *found.refuted)}
    if not others:
        return []
    key = preferred(others, found.base)
    if key is None and not found.accepted:  # a part of what is missing need not be worth its price alone
        key = max(others, key=lambda k: others[k].log_likelihood)
    least = min(others, key=lambda k: mean_ratio(others[k].rmse, found.base.rmse))
    falls = mean_ratio(others[least].rmse, found.base.rmse) < HALF_THE_ERROR
    return list(dict.fromkeys([*([] if key is None else [key]), *([least] if falls else [])]))


def _begun_with(key: Key, found: Search, first: dict[Key, Structure], task: Task) -> Search:
    """The search that begins with this effect."""
    best = polished(first[key], task.experiments)
    present = {use.key for use in found.base.model.effects}
    other = replace(
        found,
        best=best,
        before=[found.base],
        alternatives=[first | {key: best}],
        accepted=[key],
        refuted=[],
        held_out={},
        plain=[],
        timing=[shift for shift in found.timing if shift in present],
    )
    grow(other, task)
    settle(other, task)
    return other


def _shot_besides(found: Search, task: Task) -> bool:
    """Accept one more effect that shooting finds where much more than noise is left; whether there is one."""
    best = found.best
    if len(found.accepted) >= task.most_effects or times_its_innovations(best) < MUCH_LEFT:
        return False
    screen = Screen(best, task.experiments, task.origin(best))
    task.tell("trying effects over short stretches")
    models = effects_by_shooting(screen, task.candidates(best))
    tops = _tops(models, best, task)
    if not tops:
        return False
    key, better = next(iter(tops.items()))
    if key in found.refuted or tempered_gain(better, best) - better.penalty(best) < evidence_asked(found, ACCEPT_MORE):
        return False
    if not holds_up(found, key, better, task.experiments):
        return False
    del found.before[len(found.accepted) :], found.alternatives[len(found.accepted) :]
    found.before.append(best)
    found.alternatives.append(tops)
    found.accepted.append(key)
    found.best = better
    return True


def _begun_with_two(found: Search, task: Task) -> Search | None:
    """The search that begins with the two effects that shooting finds; None where they do not hold up."""
    base = found.base
    screen = Screen(base, task.experiments, task.origin(base))
    task.tell("trying pairs of effects over short stretches")
    pairs = pairs_by_shooting(screen, task.candidates(base))
    tops = _tops(pairs, base, task)
    if not tops:
        return None
    best = next(iter(tops.values()))
    none = replace(found, best=base, before=[], alternatives=[], accepted=[], refuted=[], held_out={}, plain=[])
    other = with_two(none, best, task.experiments)
    if other is None:
        return None
    grow(other, task)
    exchange_all(other, task, [])
    return other


def _tops(models: Sequence[PhysicalModel], before: Structure, task: Task) -> dict[Key, Structure]:
    """Models that were found over short stretches refitted on whole experiments, by their last effect, the likeliest first; later
    looks know all of them.
    """
    fitted = side_by_side(lambda model: refit(before, model, task.experiments), models)
    tops = [polished(s, task.experiments) for s in fitted if s is not None]
    task.shot.extend(tops)
    found: dict[Key, Structure] = {}
    for top in sorted(tops, key=lambda s: -schwarz(s, before)):
        found.setdefault(top.model.effects[-1].key, top)
    return found
