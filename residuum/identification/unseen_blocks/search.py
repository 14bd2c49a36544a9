"""The beam search: effects join one after the other, and ties travel, since what is one effect alone may be told apart beside
another.

At every level each proposal beside each structure of the beam is glanced at, the best of every kind of look are fitted fully
and judged on unseen blocks, and the simplest within chance of the best leads. After each effect that joined, the unit of the
error is asked again.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from residuum.identification.physics import Key, Simulator
from residuum.identification.side_by_side import each_beside
from residuum.identification.unseen_blocks.comparing import (
    corrected,
    going_on,
    is_alike,
    is_nothing,
    is_real,
    real_ones,
    simplest,
)
from residuum.identification.unseen_blocks.data import Data, Rung
from residuum.identification.unseen_blocks.following import Track, followed
from residuum.identification.unseen_blocks.judged import Judged, judged
from residuum.identification.unseen_blocks.ladder import climb, climb_at_likelier_timing
from residuum.identification.unseen_blocks.looks import LONG, SHORT, Court, Glance, follow, followed_on, glance, look, shows
from residuum.identification.unseen_blocks.pairs import pairs
from residuum.identification.unseen_blocks.policy import (
    BEAM,
    DEEPEST,
    EXCHANGED,
    EXCHANGED_IN_NOISE,
    FOLLOWED,
    FULLY_FITTED,
    KEPT,
    NEAR_NOISE,
    RUNG_ERROR,
    TIE,
    TURNS,
    TWICE,
)
from residuum.identification.unseen_blocks.proposals import generalised, grown, proposed, special_of, specialised
from residuum.identification.unseen_blocks.scale import Scale, clipped, of_power, plain
from residuum.identification.unseen_blocks.settling import accurate, at_the_timing_it_suits, begun, settle
from residuum.identification.unseen_blocks.structure import Structure, fitted
from residuum.identification.unseen_blocks.tried import Search, Wanted, with_only
from residuum.identification.work import OutOfWork, Tell, go_on, left_out, untold

# Whether an effect joins what was found, and what it makes needless: forward selection, floating
# back after every step.


def joins(found: Search, ranked: Sequence[Judged]) -> bool:
    """Whether any is real; the simplest of the best that are is the best from now on."""
    scale, before = found.court.scale, found.best
    real = real_ones(ranked, before, found.base, scale, found.tried) or _leaving_noise(found, ranked)
    if not real:
        return False
    found.best = chosen = simplest(real, scale)
    found.group = [one for one in ranked if one is not chosen and is_alike(one, chosen, before, scale)]
    return True


def _leaving_noise(found: Search, ranked: Sequence[Judged]) -> list[Judged]:
    """The simplest of the best, where it leaves nothing but noise and is real in nats of that: what acts seldom, a limit that is
    rarely met, is ahead in few blocks alone.
    """
    chosen = None if found.court.scale.nats else simplest(ranked, found.court.scale)
    if chosen is None or chosen.cost >= found.best.cost or (turned := settle(chosen, found.court)) is None:
        return []
    court, here = turned
    before = court.judge(found.best.structure, steps=15, tolerance=1e-6)
    if before is None or before.cost - here.cost < np.log(max(found.tried, 1)) + TIE or corrected(here, before) < TWICE:
        return []
    return [chosen]


def without_needless(found: Search) -> None:
    """Take effects from the best structure that are not real beside the others: what joined first may have stood for what
    joined after it, and led that astray.
    """
    for key in found.best.keys:
        best = found.best
        less = _without(found, key) if len(best.keys) > 1 else None
        if less is not None and not is_real(best, less, found.base, found.court.scale, found.tried):
            found.best, found.group = less, []


def _without(found: Search, key: Key) -> Judged | None:
    """The best structure without one effect, from its own values on or as it was known, whichever leaves less."""
    keys = tuple(k for k in found.best.keys if k != key)
    known = found.every.pop(keys, None)
    there = [one for one in (known, with_only(found, keys)) if one is not None]
    if not there:
        return None
    found.every[keys] = min(there, key=lambda one: one.cost)
    return found.every[keys]


# Effects of which one is a special case of another: each is tried from where the other one fits.


def related(
    found: Search, here: Mapping[tuple[Key, ...], Judged], glances: Mapping[tuple[Key, ...], Glance]
) -> dict[tuple[Key, ...], Judged]:
    """Effects that generalise one of the best, or are it with many minima side by side, followed from where that one fits, and
    special cases from where the general one does. From nothing they may not be reached, or end on the way; and what joined first
    as the general case may be a special one beside another.
    """
    tasks = []
    for one in sorted(here.values(), key=lambda one: one.cost)[:BEAM]:
        general = [seen for seen in glances.values() if _is_for(seen, one, generalised(seen.key))]
        special = [
            seen for seen in glances.values() if any(special_of(k) == seen.key and _is_for(seen, one, k) for k in one.keys)
        ]
        plain = [k for k in one.keys if special_of(k) in found.proposed.difference(one.keys, (seen.key for seen in special))]
        if not (general or special or plain):
            continue
        along = followed(one.model, found.court.data, one.errors, found.court.last)
        if along is not None:
            each = [(seen, grown(seen.key, along)) for seen in general] + [
                (seen, specialised(seen.key, along)) for seen in special
            ]
            tasks += [partial(follow, models, seen, one.structure, found.court) for seen, models in each if models]
            tasks += [partial(_in_place, one.structure, k, along, found) for k in plain]
    led = each_beside(lambda task: task(), tasks)
    better: dict[tuple[Key, ...], Judged] = {}
    for end in led:
        known = None if end is None else better.get(end.keys, here.get(end.keys))
        if end is not None and (known is None or end.seen < known.seen):
            better[end.keys] = end
    return better


def _in_place(whole: Structure, key: Key, along: Track, found: Search) -> Judged | None:
    """The structure with the special case in the place of an effect, where it was not tried."""
    special = special_of(key)
    if special is None:
        return None
    keys, models = tuple(sorted({*whole.keys, special} - {key})), specialised(special, along)
    if keys in found.every or not models:
        return None
    return found.court.judge(replace(whole, keys=keys, model=models[0]), steps=15, tolerance=1e-6)


def _is_for(seen: Glance, one: Judged, other: Key | None) -> bool:
    """Whether a structure holds what was glanced at, but for another effect in the place of the new one."""
    return other in one.keys and set(one.keys) - {other} == set(seen.keys) - {seen.key}


# Where windows begin in the states that no output shows: where the filter went.


def with_unseen_states(parent: Structure, along: Track, court: Court) -> Structure:
    """The structure whose windows of a short look begin where the filter went, in the states that no output shows.

    No fit moves these: the position of an axis of which the speed is measured is 0 at the begin of every window, and no stop is
    where the axis met it.
    """
    rung, names = court.middle, list(Simulator(parent.model).states)
    unseen = _unseen_states(parent, court.last)
    if not unseen or rung.windows not in parent.states:
        return parent
    rows = along.X[court.data.rows(rung)[rung.starts[:-1]]]
    there = [{n: float(x[names.index(n)]) for n in unseen} for x in rows]
    states = [{**known, **more} for known, more in zip(parent.states[rung.windows], there, strict=True)]
    return replace(parent, states={**parent.states, rung.windows: states})


def _unseen_states(parent: Structure, last: Rung) -> list[str]:
    """States whose first values no measured output feels, on the first window of a rung."""
    simulator, part = Simulator(parent.model), last.parts[0]
    names = [f"initial:{name}" for name in simulator.free_states]
    x0 = simulator.x0({**parent.states[last.windows][0], **part.known})
    run = simulator.run_vectors(part, x0, simulator.p(), slopes=names, substeps=parent.steps[last.windows][0]) if names else None
    if run is None or run.dY is None:
        return []
    return [n for n, felt in zip(simulator.free_states, np.any(run.dY[:, part.measured], axis=(0, 1)), strict=True) if not felt]


def search(data: Data, wanted: Wanted, tell: Tell = untold, *, turns: int = TURNS) -> Search:
    """Which effects are missing in the data's model, at the input timing that suits them, which is turned so often at most.

    Where next to nothing of the first error is left, further effects join only if they leave nothing but noise.

    The timing is chosen before anything is found, and asked again with each effect that joins: at the wrong one, the next effect
    would be the half sample.

    Raises
    ------
    NotIdentifiable
        The model diverges on the records.
    """
    tell(0.0, "estimating the model as it is")
    found = begun(climb_at_likelier_timing(data) if turns == TURNS else climb(data))
    beam, kept, depth, enough = [found.best], None, 0, None
    together: list[Judged] = []
    try:
        while True:
            tell(0.1 + 0.6 * depth / DEEPEST, _beside(found.best.keys))
            ranked: list[Judged] = []
            nothing = is_nothing(found.best, found.base, found.court.scale)
            if nothing and found.best.keys and (longer := _lengthened(found)):
                beam = longer
                continue
            if nothing and enough is None:
                enough = replace(found, every=dict(found.every), group=list(found.group))
            if depth < DEEPEST and (not nothing or found.best.cost < NEAR_NOISE * found.court.scale.floor):
                glances = _glances(found, beam, wanted, kept)
                kept = _kept(glances) if kept is None else kept
                tell(0.1 + 0.6 * (depth + 0.5) / DEEPEST, _beside(found.best.keys))
                ranked, together = sorted([*_fitted(found, glances), *together], key=lambda one: one.cost), []
                found.tried = len(glances) or found.tried
            if ranked and joins(found, ranked):
                without_needless(found)
                if turns and (other := at_the_timing_it_suits(found)) is not None:
                    return search(other, wanted, tell, turns=turns - 1)
                beam, depth = settled(found, ranked), depth + 1
                if len(found.best.keys) >= (EXCHANGED_IN_NOISE if found.court.scale.nats else EXCHANGED):
                    beam = _exchanged(found, beam, wanted, kept)
            elif found.best.keys and not nothing and (longer := _lengthened(found)):
                beam = longer
            elif ranked and depth == 0 and not found.court.scale.nats:
                beam, depth = going_on(ranked, found.court.scale), depth + 1
                together = _together(found)
            else:
                break
        if found.court.scale.nats and found.best.keys:
            found.best = found.every[found.best.keys] = accurate(found.best, found.court)
    except OutOfWork:
        left_out(f"effects {_beside(found.best.keys)}")
    return found if enough is None or found.court.scale.nats else enough


def _beside(keys: Sequence[Key]) -> str:
    return "beside " + " and ".join(key.effect for key in keys) if keys else "beside nothing else"


def _glances(found: Search, beam: Sequence[Judged], wanted: Wanted, kept: set[Key] | None) -> dict[tuple[Key, ...], Glance]:
    """A glance at every proposal beside every structure of the beam."""
    tasks, seen = [], set()
    for parent in beam:
        along = followed(parent.model, found.court.data, parent.errors, found.court.last)
        if along is None:
            continue
        found.along = along if found.along is None else found.along
        begins = with_unseen_states(parent.structure, along, found.court)
        given = None if parent.keys else followed(found.court.data.model, found.court.data)
        for key in proposed(parent.model, wanted.effects, along, learned=wanted.learned, held=wanted.held):
            keys = tuple(sorted((*parent.keys, key)))
            if key not in parent.keys and keys not in seen and keys not in found.every and (kept is None or key in kept):
                seen.add(keys)
                tasks.append(partial(_glanced, begins, key, along, found.court, given))
    each = each_beside(lambda task: task(), tasks)
    found.proposed |= {one.key for one in each if one is not None}
    return {one.keys: one for one in each if one is not None}


def _glanced(parent: Structure, key: Key, along: Track, court: Court, given: Track | None) -> Glance | None:
    try:
        go_on()
        return glance(parent, key, along, court, given)
    except OutOfWork:
        left_out(f"{key.effect}@{key.target}")
        return None


def _kept(glances: dict[tuple[Key, ...], Glance]) -> set[Key]:
    """Proposals worth a look beside others: the best of the first level, and those that hide alone (own states, no slope yet)."""
    kept = {one.key for one in glances.values() if one.hides}
    for kind in (SHORT, LONG):
        there = sorted((one for one in glances.values() if kind in one.seen), key=lambda one: one.error(kind))
        kept |= {one.key for one in there[:KEPT]}
        if there:
            usual = float(np.median([one.error(kind) for one in there]))
            kept |= {one.key for one in there if abs(one.error(kind) - usual) <= 1e-6 * usual}
    return kept


def _fitted(found: Search, glances: dict[tuple[Key, ...], Glance]) -> list[Judged]:
    """The best of each kind of glance followed, the best of these fitted fully and judged, with those related to the best of
    them; the best first.
    """
    near = {one.keys: one for one in each_beside(followed_on, _best_of_each(glances.values(), FOLLOWED))}
    each = each_beside(lambda seen: _looked(seen, found.court), _best_of_each(near.values(), FULLY_FITTED))
    here = {one.keys: one for one in each if one is not None}
    here |= related(found, here, glances)
    found.every |= here
    return sorted(here.values(), key=lambda one: one.cost)


def _best_of_each(glances: Iterable[Glance], count: int) -> list[Glance]:
    """So many of each kind of look."""
    top: dict[tuple[Key, ...], Glance] = {}
    for kind in (SHORT, LONG):
        there = sorted((one for one in glances if kind in one.seen), key=lambda one: one.error(kind))
        top |= {one.keys: one for one in there[:count]}
    return list(top.values())


def _looked(seen: Glance, court: Court) -> Judged | None:
    try:
        return look(seen, court)
    except OutOfWork:
        left_out(f"{seen.key.effect}@{seen.key.target}, followed to its end")
        return None


def settled(found: Search, ranked: Sequence[Judged]) -> list[Judged]:
    """The beam for the next level; where the unit of the error turned, its structures judged anew."""
    turned = None if found.court.scale.nats else settle(found.best, found.court)
    if turned is None:
        beam = going_on(ranked, found.court.scale)
        return beam if found.best in beam else [found.best, *beam[:-1]]
    court, best = turned
    again = [one for one in ranked if one.keys != best.keys][: 2 * BEAM]
    fits = [best, *(one for one in (court.judge(o.structure, steps=15, tolerance=1e-6) for o in again) if one is not None)]
    base = court.judge(found.base.structure, steps=15, tolerance=1e-6) or found.base
    chosen = simplest(fits, court.scale)
    found.court, found.best, found.base = court, chosen, base
    found.every = {one.keys: one for one in [*fits, base]}
    others = [one for one in fits if not set(one.keys) >= set(chosen.keys)]
    found.group = [one for one in others if is_alike(one, chosen, None, court.scale)]
    return [chosen, *found.group][:BEAM]


def _together(found: Search) -> list[Judged]:
    """Pairs that gain beside the model as it is, where none joins it alone."""
    along = followed(found.base.model, found.court.data, found.base.errors, found.court.last)
    there = [] if along is None else pairs(found.base, sorted(found.proposed), along, found.court)
    found.every |= {one.keys: one for one in there}
    return there


def _exchanged(found: Search, beam: list[Judged], wanted: Wanted, kept: set[Key] | None) -> list[Judged]:
    """The beam, led by what leaves less than the best structure with another effect in the place of one of its own.

    What joined first was the best beside nothing: it stands for two effects that gain together only, until both are there.
    """
    parents = [one for key in found.best.keys if (one := with_only(found, set(found.best.keys) - {key})) is not None]
    ranked = _fitted(found, _glances(found, parents, wanted, kept))
    better = [one for one in ranked if one.cost < found.best.cost and one.rarity <= found.best.rarity]
    if not better:
        return beam
    before, scale = found.best, found.court.scale
    found.best = simplest([before, *better], scale)
    there = sorted([before, *ranked, *found.group], key=lambda one: one.cost)
    found.group = [one for one in there if one is not found.best and is_alike(one, found.best, None, scale)]
    return [found.best, *(one for one in beam if one is not found.best)][:BEAM]


def _lengthened(found: Search) -> list[Judged]:
    """The beam on the longest windows up to which the best one follows all now; base and beam are judged there from now on. Empty
    where it does not follow the next longer ones.

    What looked best on short windows goes with those that stood beside it: a second store of heat is a loss until it is full.
    """
    beam: list[Judged] = []
    while longer := _on_next_windows(found):
        beam = longer
    return beam


def _on_next_windows(found: Search) -> list[Judged]:
    """The beam on the next longer windows."""
    data, court = found.court.data, found.court
    longer = [rung for rung in data.rungs if rung.windows < court.last.windows]
    if court.scale.nats or not longer:
        return []
    rung, flat = longer[0], plain(data)
    base = fitted(data.model, rung, None, flat, steps=15, tolerance=1e-4)
    if base is None:
        return []
    scale = clipped(flat, base.residuals, rung)
    first = judged(found.base.structure.at(rung, base), base.in_unit(scale).descended(6, 1e-4), rung, data, scale)
    if first is None:
        return []
    scale = of_power(scale, data, first.power)
    like = [one for one in found.every.values() if len(one.keys) == len(found.best.keys) and one is not found.best]
    tasks = [found.best, *sorted(like, key=lambda one: one.cost)[: 2 * BEAM]]
    there = each_beside(lambda one: _on_longer_windows(one, rung, flat, scale, found), tasks)
    ranked = sorted((one for one in there if one is not None), key=lambda one: one.cost)
    if not ranked:
        return []
    first = replace(first, cost=scale.cost(first.power, first.parameters))
    found.court, found.base, found.best = replace(court, last=rung, scale=scale), first, simplest(ranked, scale)
    found.every = {(): first} | {one.keys: one for one in ranked}
    found.group = [one for one in ranked if one is not found.best and is_alike(one, found.best, None, scale)]
    return [found.best, *(one for one in going_on(ranked, scale) if one is not found.best)][:BEAM]


def _on_longer_windows(one: Judged, rung: Rung, flat: Scale, scale: Scale, found: Search) -> Judged | None:
    """A structure fitted and judged on longer windows; None where it does not follow them, or shows less than an unknown load."""
    fit = fitted(one.model, rung, None, flat, steps=15, tolerance=1e-4)
    if fit is None or fit.mean > RUNG_ERROR:
        return None
    fit = fit.in_unit(scale).descended(6, 1e-4)
    if found.along is not None and not shows(fit.model, found.along, rung):
        return None
    return judged(one.structure.at(rung, fit), fit, rung, found.court.data, scale)
