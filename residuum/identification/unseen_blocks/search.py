"""The beam search: effects join one after the other, and ties travel, since what is one effect
alone may be told apart beside another.

At every level each proposal beside each structure of the beam is glanced at, the best of every kind
of look are fitted fully and judged on unseen blocks, and the simplest within chance of the best
leads. After each effect that joined, the unit of the error is asked again.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from residuum.identification.physics import Key
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
from residuum.identification.unseen_blocks.looks import (
    LONG,
    SHORT,
    Court,
    Glance,
    follow,
    followed_on,
    glance,
    look,
    shows,
)
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
from residuum.identification.unseen_blocks.proposals import (
    generalised,
    grown,
    proposed,
    special_of,
    specialised,
)
from residuum.identification.unseen_blocks.scale import Scale, clipped, of_power, plain
from residuum.identification.unseen_blocks.settling import (
    accurate,
    at_the_timing_it_suits,
    begun,
    settle,
)
from residuum.identification.unseen_blocks.structure import Structure, fitted
from residuum.identification.unseen_blocks.tried import Search, Wanted, with_only
from residuum.identification.unseen_blocks.unseen_states import with_unseen_states
from residuum.identification.work import OutOfWork, Tell, go_on, left_out, untold

# Whether an effect joins what was found, and what it makes needless: forward selection, floating
# back after every step.


def joins(outcome: Search, ranked: Sequence[Judged]) -> bool:
    """Whether any is real; the simplest of the best that are is the best from now on."""
    scale, before = outcome.court.scale, outcome.best
    real = real_ones(ranked, before, outcome.base, scale, outcome.tried) or _leaving_noise(
        outcome, ranked
    )
    if not real:
        return False
    outcome.best = chosen = simplest(real, scale)
    outcome.group = [
        rival for rival in ranked if rival is not chosen and is_alike(rival, chosen, before, scale)
    ]
    return True


def _leaving_noise(outcome: Search, ranked: Sequence[Judged]) -> list[Judged]:
    """The simplest of the best, where it leaves nothing but noise and is real in nats of that: what
    acts seldom, a limit that is rarely met, is ahead in few blocks alone.
    """
    chosen = None if outcome.court.scale.nats else simplest(ranked, outcome.court.scale)
    if (
        chosen is None
        or chosen.cost >= outcome.best.cost
        or (turned := settle(chosen, outcome.court)) is None
    ):
        return []
    court, in_nats = turned
    before = court.judge(outcome.best.structure, steps=15, tolerance=1e-6)
    if (
        before is None
        or before.cost - in_nats.cost < np.log(max(outcome.tried, 1)) + TIE
        or corrected(in_nats, before) < TWICE
    ):
        return []
    return [chosen]


def without_needless(outcome: Search) -> None:
    """Take effects from the best structure that are not real beside the others: what joined first
    may have stood for what joined after it, and led that astray.
    """
    for key in outcome.best.keys:
        best = outcome.best
        less = _without(outcome, key) if len(best.keys) > 1 else None
        if less is not None and not is_real(
            best, less, outcome.base, outcome.court.scale, outcome.tried
        ):
            outcome.best, outcome.group = less, []


def _without(outcome: Search, key: Key) -> Judged | None:
    """The best structure without one effect, from its own values on or as it was known, whichever
    leaves less.
    """
    keys = tuple(k for k in outcome.best.keys if k != key)
    known = outcome.every.pop(keys, None)
    versions = [version for version in (known, with_only(outcome, keys)) if version is not None]
    if not versions:
        return None
    outcome.every[keys] = min(versions, key=lambda version: version.cost)
    return outcome.every[keys]


# Effects of which one is a special case of another: each is tried from where the other one fits.


def related(
    outcome: Search,
    by_keys: Mapping[tuple[Key, ...], Judged],
    glances: Mapping[tuple[Key, ...], Glance],
) -> dict[tuple[Key, ...], Judged]:
    """Effects that generalise one of the best, or are it with many minima side by side, followed
    from where that one fits, and special cases from where the general one does. From nothing they
    may not be reached, or end on the way; and what joined first as the general case may be a
    special one beside another.
    """
    tasks = []
    for lead in sorted(by_keys.values(), key=lambda lead: lead.cost)[:BEAM]:
        general = [view for view in glances.values() if _is_for(view, lead, generalised(view.key))]
        special = [
            view
            for view in glances.values()
            if any(special_of(k) == view.key and _is_for(view, lead, k) for k in lead.keys)
        ]
        plain = [
            k
            for k in lead.keys
            if special_of(k)
            in outcome.proposed.difference(lead.keys, (view.key for view in special))
        ]
        if not (general or special or plain):
            continue
        along = followed(lead.model, outcome.court.data, lead.errors, outcome.court.last)
        if along is not None:
            begins = [(view, grown(view.key, along)) for view in general] + [
                (view, specialised(view.key, along)) for view in special
            ]
            tasks += [
                partial(follow, models, view, lead.structure, outcome.court)
                for view, models in begins
                if models
            ]
            tasks += [partial(_in_place, lead.structure, k, along, outcome) for k in plain]
    led = each_beside(lambda task: task(), tasks)
    better: dict[tuple[Key, ...], Judged] = {}
    for end in led:
        known = None if end is None else better.get(end.keys, by_keys.get(end.keys))
        if end is not None and (known is None or end.seen < known.seen):
            better[end.keys] = end
    return better


def _in_place(whole: Structure, key: Key, along: Track, outcome: Search) -> Judged | None:
    """The structure with the special case in the place of an effect, where it was not tried."""
    special = special_of(key)
    if special is None:
        return None
    keys, models = tuple(sorted({*whole.keys, special} - {key})), specialised(special, along)
    if keys in outcome.every or not models:
        return None
    return outcome.court.judge(replace(whole, keys=keys, model=models[0]), steps=15, tolerance=1e-6)


def _is_for(view: Glance, candidate: Judged, stand_in: Key | None) -> bool:
    """Whether a structure holds what was glanced at, but for another effect in the place of the new
    one.
    """
    return stand_in in candidate.keys and set(candidate.keys) - {stand_in} == set(view.keys) - {
        view.key
    }


def search(data: Data, wanted: Wanted, tell: Tell = untold, *, turns: int = TURNS) -> Search:
    """Which effects are missing in the data's model, at the input timing that suits them, which is
    turned so often at most.

    Where next to nothing of the first error is left, further effects join only if they leave
    nothing but noise.

    The timing is chosen before anything is found, and asked again with each effect that joins: at
    the wrong one, the next effect would be the half sample.

    Raises
    ------
    NotIdentifiable
        The model diverges on the records.
    """
    tell(0.0, "estimating the model as it is")
    outcome = begun(climb_at_likelier_timing(data) if turns == TURNS else climb(data))
    beam, viable, depth, enough = [outcome.best], None, 0, None
    together: list[Judged] = []
    try:
        while True:
            tell(0.1 + 0.6 * depth / DEEPEST, _beside(outcome.best.keys))
            ranked: list[Judged] = []
            nothing = is_nothing(outcome.best, outcome.base, outcome.court.scale)
            if nothing and outcome.best.keys and (longer := _lengthened(outcome)):
                beam = longer
                continue
            if nothing and enough is None:
                enough = replace(outcome, every=dict(outcome.every), group=list(outcome.group))
            if depth < DEEPEST and (
                not nothing or outcome.best.cost < NEAR_NOISE * outcome.court.scale.floor
            ):
                glances = _glances(outcome, beam, wanted, viable)
                viable = _kept(glances) if viable is None else viable
                tell(0.1 + 0.6 * (depth + 0.5) / DEEPEST, _beside(outcome.best.keys))
                ranked, together = (
                    sorted([*_fitted(outcome, glances), *together], key=lambda rival: rival.cost),
                    [],
                )
                outcome.tried = len(glances) or outcome.tried
            if ranked and joins(outcome, ranked):
                without_needless(outcome)
                if turns and (retimed := at_the_timing_it_suits(outcome)) is not None:
                    return search(retimed, wanted, tell, turns=turns - 1)
                beam, depth = settled(outcome, ranked), depth + 1
                if len(outcome.best.keys) >= (
                    EXCHANGED_IN_NOISE if outcome.court.scale.nats else EXCHANGED
                ):
                    beam = _exchanged(outcome, beam, wanted, viable)
            elif outcome.best.keys and not nothing and (longer := _lengthened(outcome)):
                beam = longer
            elif ranked and depth == 0 and not outcome.court.scale.nats:
                beam, depth = going_on(ranked, outcome.court.scale), depth + 1
                together = _together(outcome)
            else:
                break
        if outcome.court.scale.nats and outcome.best.keys:
            outcome.best = outcome.every[outcome.best.keys] = accurate(outcome.best, outcome.court)
    except OutOfWork:
        left_out(f"effects {_beside(outcome.best.keys)}")
    return outcome if enough is None or outcome.court.scale.nats else enough


def _beside(keys: Sequence[Key]) -> str:
    return "beside " + " and ".join(key.effect for key in keys) if keys else "beside nothing else"


def _glances(
    outcome: Search, beam: Sequence[Judged], wanted: Wanted, viable: set[Key] | None
) -> dict[tuple[Key, ...], Glance]:
    """A glance at every proposal beside every structure of the beam."""
    tasks, queued = [], set()
    for parent in beam:
        along = followed(parent.model, outcome.court.data, parent.errors, outcome.court.last)
        if along is None:
            continue
        outcome.along = along if outcome.along is None else outcome.along
        begins = with_unseen_states(parent.structure, along, outcome.court)
        given = None if parent.keys else followed(outcome.court.data.model, outcome.court.data)
        for key in proposed(
            parent.model, wanted.effects, along, learned=wanted.learned, held=wanted.held
        ):
            keys = tuple(sorted((*parent.keys, key)))
            if (
                key not in parent.keys
                and keys not in queued
                and keys not in outcome.every
                and (viable is None or key in viable)
            ):
                queued.add(keys)
                tasks.append(partial(_glanced, begins, key, along, outcome.court, given))
    views = each_beside(lambda task: task(), tasks)
    outcome.proposed |= {view.key for view in views if view is not None}
    return {view.keys: view for view in views if view is not None}


def _glanced(
    parent: Structure, key: Key, along: Track, court: Court, given: Track | None
) -> Glance | None:
    try:
        go_on()
        return glance(parent, key, along, court, given)
    except OutOfWork:
        left_out(f"{key.effect}@{key.target}")
        return None


def _kept(glances: dict[tuple[Key, ...], Glance]) -> set[Key]:
    """Proposals worth a look beside others: the best of the first level, and those that hide alone
    (own states, no slope yet).
    """
    viable = {view.key for view in glances.values() if view.hides}
    for kind in (SHORT, LONG):
        ranked = sorted(
            (view for view in glances.values() if kind in view.seen),
            key=lambda view: view.error(kind),
        )
        viable |= {view.key for view in ranked[:KEPT]}
        if ranked:
            usual = float(np.median([view.error(kind) for view in ranked]))
            viable |= {view.key for view in ranked if abs(view.error(kind) - usual) <= 1e-6 * usual}
    return viable


def _fitted(outcome: Search, glances: dict[tuple[Key, ...], Glance]) -> list[Judged]:
    """The best of each kind of glance followed, the best of these fitted fully and judged, with
    those related to the best of them; the best first.
    """
    near = {
        rival.keys: rival
        for rival in each_beside(followed_on, _best_of_each(glances.values(), FOLLOWED))
    }
    fits = each_beside(
        lambda view: _looked(view, outcome.court), _best_of_each(near.values(), FULLY_FITTED)
    )
    by_keys = {rival.keys: rival for rival in fits if rival is not None}
    by_keys |= related(outcome, by_keys, glances)
    outcome.every |= by_keys
    return sorted(by_keys.values(), key=lambda rival: rival.cost)


def _best_of_each(glances: Iterable[Glance], count: int) -> list[Glance]:
    """So many of each kind of look."""
    top: dict[tuple[Key, ...], Glance] = {}
    for kind in (SHORT, LONG):
        ranked = sorted(
            (view for view in glances if kind in view.seen), key=lambda view: view.error(kind)
        )
        top |= {view.keys: view for view in ranked[:count]}
    return list(top.values())


def _looked(view: Glance, court: Court) -> Judged | None:
    try:
        return look(view, court)
    except OutOfWork:
        left_out(f"{view.key.effect}@{view.key.target}, followed to its end")
        return None


def settled(outcome: Search, ranked: Sequence[Judged]) -> list[Judged]:
    """The beam for the next level; where the unit of the error turned, its structures judged
    anew.
    """
    turned = None if outcome.court.scale.nats else settle(outcome.best, outcome.court)
    if turned is None:
        beam = going_on(ranked, outcome.court.scale)
        return beam if outcome.best in beam else [outcome.best, *beam[:-1]]
    court, best = turned
    again = [rival for rival in ranked if rival.keys != best.keys][: 2 * BEAM]
    fits = [
        best,
        *(
            rival
            for rival in (court.judge(o.structure, steps=15, tolerance=1e-6) for o in again)
            if rival is not None
        ),
    ]
    base = court.judge(outcome.base.structure, steps=15, tolerance=1e-6) or outcome.base
    chosen = simplest(fits, court.scale)
    outcome.court, outcome.best, outcome.base = court, chosen, base
    outcome.every = {rival.keys: rival for rival in [*fits, base]}
    rivals = [rival for rival in fits if not set(rival.keys) >= set(chosen.keys)]
    outcome.group = [rival for rival in rivals if is_alike(rival, chosen, None, court.scale)]
    return [chosen, *outcome.group][:BEAM]


def _together(outcome: Search) -> list[Judged]:
    """Pairs that gain beside the model as it is, where none joins it alone."""
    along = followed(
        outcome.base.model, outcome.court.data, outcome.base.errors, outcome.court.last
    )
    judged_pairs = (
        [] if along is None else pairs(outcome.base, sorted(outcome.proposed), along, outcome.court)
    )
    outcome.every |= {pair.keys: pair for pair in judged_pairs}
    return judged_pairs


def _exchanged(
    outcome: Search, beam: list[Judged], wanted: Wanted, viable: set[Key] | None
) -> list[Judged]:
    """The beam, led by what leaves less than the best structure with another effect in the place of
    one of its own.

    What joined first was the best beside nothing: it stands for two effects that gain together
    only, until both are there.
    """
    parents = [
        rival
        for key in outcome.best.keys
        if (rival := with_only(outcome, set(outcome.best.keys) - {key})) is not None
    ]
    ranked = _fitted(outcome, _glances(outcome, parents, wanted, viable))
    better = [
        rival
        for rival in ranked
        if rival.cost < outcome.best.cost and rival.rarity <= outcome.best.rarity
    ]
    if not better:
        return beam
    before, scale = outcome.best, outcome.court.scale
    outcome.best = simplest([before, *better], scale)
    rivals = sorted([before, *ranked, *outcome.group], key=lambda rival: rival.cost)
    outcome.group = [
        rival
        for rival in rivals
        if rival is not outcome.best and is_alike(rival, outcome.best, None, scale)
    ]
    return [outcome.best, *(rival for rival in beam if rival is not outcome.best)][:BEAM]


def _lengthened(outcome: Search) -> list[Judged]:
    """The beam on the longest windows up to which the best one follows all now; base and beam are
    judged there from now on. Empty where it does not follow the next longer ones.

    What looked best on short windows goes with those that stood beside it: a second store of heat
    is a loss until it is full.
    """
    beam: list[Judged] = []
    while longer := _on_next_windows(outcome):
        beam = longer
    return beam


def _on_next_windows(outcome: Search) -> list[Judged]:
    """The beam on the next longer windows."""
    data, court = outcome.court.data, outcome.court
    longer = [rung for rung in data.rungs if rung.windows < court.last.windows]
    if court.scale.nats or not longer:
        return []
    rung, flat = longer[0], plain(data)
    base = fitted(data.model, rung, None, flat, steps=15, tolerance=1e-4)
    if base is None:
        return []
    scale = clipped(flat, base.residuals, rung)
    first = judged(
        outcome.base.structure.at(rung, base),
        base.in_unit(scale).descended(6, 1e-4),
        rung,
        data,
        scale,
    )
    if first is None:
        return []
    scale = of_power(scale, data, first.power)
    like = [
        rival
        for rival in outcome.every.values()
        if len(rival.keys) == len(outcome.best.keys) and rival is not outcome.best
    ]
    tasks = [outcome.best, *sorted(like, key=lambda rival: rival.cost)[: 2 * BEAM]]
    refits = each_beside(lambda rival: _on_longer_windows(rival, rung, flat, scale, outcome), tasks)
    ranked = sorted((rival for rival in refits if rival is not None), key=lambda rival: rival.cost)
    if not ranked:
        return []
    first = replace(first, cost=scale.cost(first.power, first.parameters))
    outcome.court, outcome.base, outcome.best = (
        replace(court, last=rung, scale=scale),
        first,
        simplest(ranked, scale),
    )
    outcome.every = {(): first} | {rival.keys: rival for rival in ranked}
    outcome.group = [
        rival
        for rival in ranked
        if rival is not outcome.best and is_alike(rival, outcome.best, None, scale)
    ]
    return [
        outcome.best,
        *(rival for rival in going_on(ranked, scale) if rival is not outcome.best),
    ][:BEAM]


def _on_longer_windows(
    candidate: Judged, rung: Rung, flat: Scale, scale: Scale, outcome: Search
) -> Judged | None:
    """A structure fitted and judged on longer windows; None where it does not follow them, or shows
    less than an unknown load.
    """
    fit = fitted(candidate.model, rung, None, flat, steps=15, tolerance=1e-4)
    if fit is None or fit.mean > RUNG_ERROR:
        return None
    fit = fit.in_unit(scale).descended(6, 1e-4)
    if outcome.along is not None and not shows(fit.model, outcome.along, rung):
        return None
    return judged(candidate.structure.at(rung, fit), fit, rung, outcome.court.data, scale)
