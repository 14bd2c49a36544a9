"""The beam search: effects join one after the other, and ties travel, since what is one effect
alone may be told apart beside another.

At every level each proposal beside each structure of the beam is glanced at, the best of every kind
of look are fitted fully and judged on unseen blocks, and the simplest within chance of the best
leads. After each effect that joined, the unit of the error is asked again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

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
from residuum.identification.unseen_blocks.following import Track, followed
from residuum.identification.unseen_blocks.judged import Court, Judged, judged
from residuum.identification.unseen_blocks.ladder import climb, climb_at_likelier_timing
from residuum.identification.unseen_blocks.looks import (
    Glance,
    best_of_each,
    follow,
    followed_on,
    glance,
    look,
    shows,
    with_unseen_states,
    worth_beside_others,
)
from residuum.identification.unseen_blocks.pairs import pairs
from residuum.identification.unseen_blocks.policy import (
    BEAM,
    DEEPEST,
    EXCHANGED,
    EXCHANGED_IN_NOISE,
    FOLLOWED,
    FULLY_FITTED,
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
from residuum.identification.unseen_blocks.structure import Structure, fitted
from residuum.identification.unseen_blocks.tried import (
    Search,
    Wanted,
    accurate,
    at_the_timing_it_suits,
    begun,
    settle,
    with_only,
)
from residuum.identification.work import OutOfWork, Tell, go_on, left_out, untold

if TYPE_CHECKING:
    from residuum.identification.unseen_blocks.data import Data, Rung

# Whether an effect joins what was found, and what it makes needless: forward selection, floating
# back after every step.


def joins(outcome: Search, ranked: Sequence[Judged]) -> bool:
    """Whether any is real; the simplest of the best that are is the best from now on."""
    scale, before = outcome.court.scale, outcome.best
    real = real_ones(ranked, before, outcome.base, scale, outcome.tried)
    if not real:
        real = _leaving_noise(outcome, ranked)
    if not real:
        return False
    chosen = simplest(real, scale)
    outcome.best = chosen
    outcome.group = _alike(ranked, chosen, before, scale)
    return True


def _alike(
    ranked: Sequence[Judged], chosen: Judged, before: Judged | None, scale: Scale
) -> list[Judged]:
    """Those that the data cannot tell from the chosen one, in the place of `before`."""
    return [
        rival for rival in ranked if rival is not chosen and is_alike(rival, chosen, before, scale)
    ]


def _leaving_noise(outcome: Search, ranked: Sequence[Judged]) -> list[Judged]:
    """The simplest of the best, where it leaves nothing but noise and is real in nats of that: what
    acts seldom, a limit that is rarely met, is ahead in few blocks alone.
    """
    if outcome.court.scale.nats:
        return []
    chosen = simplest(ranked, outcome.court.scale)
    if chosen.cost >= outcome.best.cost:
        return []
    in_noise = settle(chosen, outcome.court)
    if in_noise is None:
        return []
    court, in_nats = in_noise
    before = court.judge(outcome.best.structure, steps=15, tolerance=1e-6)
    if before is None:
        return []
    gain = before.cost - in_nats.cost
    # the logarithm of how many were tried is the price of the choice among them (Bonferroni)
    worth = np.log(max(outcome.tried, 1)) + TIE
    return [] if gain < worth or corrected(in_nats, before) < TWICE else [chosen]


def without_needless(outcome: Search) -> None:
    """Take effects from the best structure that are not real beside the others: what joined first
    may have stood for what joined after it, and led that astray.
    """
    for key in outcome.best.keys:
        best = outcome.best
        # one at a time, each beside what the one before left: two that stand for each other are
        # both needless beside the other, and one of them has to stay
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
    known = outcome.every.pop(keys, None)  # so that it is fitted from the best one's values, too
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
    leading = sorted(by_keys.values(), key=lambda lead: lead.cost)[:BEAM]
    tasks = [task for lead in leading for task in _relatives(lead, outcome, glances)]
    better: dict[tuple[Key, ...], Judged] = {}
    for fit in each_beside(lambda task: task(), tasks):
        if fit is None:
            continue
        known = better.get(fit.keys, by_keys.get(fit.keys))
        if known is None or fit.seen < known.seen:
            better[fit.keys] = fit
    return better


def _relatives(
    lead: Judged, outcome: Search, glances: Mapping[tuple[Key, ...], Glance]
) -> list[Callable[[], Judged | None]]:
    """The fits of what is related to the effects of a structure, to be made."""
    general = [view for view in glances.values() if _is_for(view, lead, generalised(view.key))]
    special = [
        view
        for view in glances.values()
        if any(special_of(key) == view.key and _is_for(view, lead, key) for key in lead.keys)
    ]
    # special cases that were proposed and are not among these glances: they were looked at alone,
    # at another level, and nobody asked for them beside what has joined since
    elsewhere = outcome.proposed.difference(lead.keys, (view.key for view in special))
    replaceable = [key for key in lead.keys if special_of(key) in elsewhere]
    if not (general or special or replaceable):
        return []
    along = followed(lead.model, outcome.court.data, lead.errors, outcome.court.last)
    if along is None:
        return []
    begins = [(view, grown(view.key, along)) for view in general]
    begins += [(view, specialised(view.key, along)) for view in special]
    near, court = lead.structure, outcome.court
    return [
        *(partial(follow, models, view, near, court) for view, models in begins if models),
        *(partial(_in_place, near, key, along, outcome) for key in replaceable),
    ]


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
    others, new = set(candidate.keys) - {stand_in}, view.key
    return stand_in in candidate.keys and others == set(view.keys) - {new}


# The beam search itself.


@dataclass(eq=False)
class _Beam:
    """How far a beam search is: beside which `structures` effects are tried at the next level, with
    how many at most, `depth`.

    `viable` are the proposals worth a look beside others (None: the first level chooses them);
    `together` pairs that were fitted for the next level; `enough` what was found when next to
    nothing of the first error was left.
    """

    outcome: Search
    wanted: Wanted
    tell: Tell
    structures: list[Judged]
    viable: set[Key] | None = None
    depth: int = 0
    together: list[Judged] = field(default_factory=list)
    enough: Search | None = None

    @property
    def nothing(self) -> bool:
        """Whether next to nothing of the first error is left."""
        return is_nothing(self.outcome.best, self.outcome.base, self.outcome.court.scale)

    def progress(self, level_done: float) -> None:
        """Tell how far the search is: what is left of it nobody knows, so levels count."""
        self.tell(0.1 + 0.6 * (self.depth + level_done) / DEEPEST, _beside(self.outcome.best.keys))


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
    beam = _Beam(outcome, wanted, tell, [outcome.best])
    try:
        going = True
        while going:
            ranked = _next_level(beam)
            if ranked and joins(outcome, ranked):
                without_needless(outcome)
                # asked before anything else is tried beside it: all of that would be tried anew
                retimed = at_the_timing_it_suits(outcome) if turns else None
                if retimed is not None:
                    return search(retimed, wanted, tell, turns=turns - 1)
                _go_deeper(beam, ranked)
            else:
                going = _go_on_otherwise(beam, ranked)
        if outcome.court.scale.nats and outcome.best.keys:
            outcome.best = outcome.every[outcome.best.keys] = accurate(outcome.best, outcome.court)
    except OutOfWork:
        left_out(f"effects {_beside(outcome.best.keys)}")
    # what joined below next to nothing counts only where it left noise alone
    return outcome if beam.enough is None or outcome.court.scale.nats else beam.enough


def _next_level(beam: _Beam) -> list[Judged]:
    """What was tried beside the structures of the beam, fitted and judged, the best first; nothing
    where no more is sought.
    """
    outcome = beam.outcome
    beam.progress(0.0)
    nothing = beam.nothing
    # what leaves next to nothing in short windows may leave much in long ones
    longer = lengthened(outcome) if nothing and outcome.best.keys else []
    while longer:
        beam.structures = longer
        beam.progress(0.0)
        nothing = beam.nothing
        longer = lengthened(outcome) if nothing else []
    if nothing and beam.enough is None:
        beam.enough = replace(outcome, every=dict(outcome.every), group=list(outcome.group))
    near_noise = outcome.best.cost < NEAR_NOISE * outcome.court.scale.floor
    if beam.depth >= DEEPEST or (nothing and not near_noise):
        return []
    glances = _glances(outcome, beam.structures, beam.wanted, beam.viable)
    if beam.viable is None:
        beam.viable = worth_beside_others(glances.values())
    beam.progress(0.5)
    ranked = [*_fitted(outcome, glances), *beam.together]
    beam.together = []
    outcome.tried = len(glances) or outcome.tried
    return sorted(ranked, key=lambda rival: rival.cost)


def _go_deeper(beam: _Beam, ranked: Sequence[Judged]) -> None:
    """The structures of the next level, where an effect joined."""
    outcome = beam.outcome
    beam.structures = settled(outcome, ranked)
    beam.depth += 1
    # of two effects in power each was looked at alone, so an exchange has nothing new to find
    fewest = EXCHANGED_IN_NOISE if outcome.court.scale.nats else EXCHANGED
    if len(outcome.best.keys) >= fewest:
        beam.structures = exchanged(outcome, beam.structures, beam.wanted, beam.viable)


def _go_on_otherwise(beam: _Beam, ranked: Sequence[Judged]) -> bool:
    """Where nothing joined: whether to go on, on longer windows, or with pairs of effects where
    none joined the model as it is.
    """
    outcome = beam.outcome
    if outcome.best.keys and not beam.nothing:
        longer = lengthened(outcome)
        if longer:
            beam.structures = longer
            return True
    if ranked and beam.depth == 0 and not outcome.court.scale.nats:
        beam.structures = going_on(ranked, outcome.court.scale)
        beam.depth += 1
        beam.together = _together(outcome)
        return True
    return False


def _beside(keys: Sequence[Key]) -> str:
    return "beside " + " and ".join(key.effect for key in keys) if keys else "beside nothing else"


def _glances(
    outcome: Search, parents: Sequence[Judged], wanted: Wanted, viable: set[Key] | None
) -> dict[tuple[Key, ...], Glance]:
    """A glance at every proposal beside every one of the structures."""
    tasks: list[Callable[[], Glance | None]] = []
    queued: set[tuple[Key, ...]] = set()
    for parent in parents:
        along = followed(parent.model, outcome.court.data, parent.errors, outcome.court.last)
        if along is None:
            continue
        outcome.along = along if outcome.along is None else outcome.along
        begins = with_unseen_states(parent.structure, along, outcome.court)
        # what is missing may have driven the fitted values of the model as it is far away; what
        # joined has drawn them back
        given = None if parent.keys else followed(outcome.court.data.model, outcome.court.data)
        for key in _proposals_beside(parent, along, wanted, viable):
            keys = tuple(sorted((*parent.keys, key)))
            # {A} beside B and {B} beside A are one structure
            if keys not in queued and keys not in outcome.every:
                queued.add(keys)
                tasks.append(partial(_glanced, begins, key, along, outcome.court, given))
    views = [view for view in each_beside(lambda task: task(), tasks) if view is not None]
    outcome.proposed |= {view.key for view in views}
    return {view.keys: view for view in views}


def _proposals_beside(
    parent: Judged, along: Track, wanted: Wanted, viable: set[Key] | None
) -> list[Key]:
    """What may join a structure, of those that are viable."""
    keys = proposed(parent.model, wanted.effects, along, learned=wanted.learned, held=wanted.held)
    return [key for key in keys if key not in parent.keys and (viable is None or key in viable)]


def _glanced(
    parent: Structure, key: Key, along: Track, court: Court, given: Track | None
) -> Glance | None:
    try:
        go_on()
        return glance(parent, key, along, court, given)
    except OutOfWork:
        left_out(f"{key.effect}@{key.target}")
        return None


def _fitted(outcome: Search, glances: Mapping[tuple[Key, ...], Glance]) -> list[Judged]:
    """The best of each kind of glance followed, the best of these fitted fully and judged, with
    those related to the best of them; the best first.
    """
    # errors after one step rank roughly, a full fit is dear: so two steps more for some, and full
    # fits for the best of those
    best_glances = best_of_each(glances.values(), FOLLOWED)
    near = {view.keys: view for view in each_beside(followed_on, best_glances)}
    fits = each_beside(
        lambda view: _looked(view, outcome.court), best_of_each(near.values(), FULLY_FITTED)
    )
    by_keys = {rival.keys: rival for rival in fits if rival is not None}
    by_keys |= related(outcome, by_keys, glances)
    outcome.every |= by_keys
    return sorted(by_keys.values(), key=lambda rival: rival.cost)


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
    in_noise = None if outcome.court.scale.nats else settle(outcome.best, outcome.court)
    if in_noise is None:
        beam = going_on(ranked, outcome.court.scale)
        return beam if outcome.best in beam else [outcome.best, *beam[:-1]]
    court, best = in_noise
    # costs in power and in nats have nothing in common: all that stays is judged in the new unit
    again = [rival for rival in ranked if rival.keys != best.keys][: 2 * BEAM]
    refits = [court.judge(rival.structure, steps=15, tolerance=1e-6) for rival in again]
    fits = [best, *(fit for fit in refits if fit is not None)]
    base = court.judge(outcome.base.structure, steps=15, tolerance=1e-6) or outcome.base
    chosen = simplest(fits, court.scale)
    outcome.court, outcome.best, outcome.base = court, chosen, base
    outcome.every = {rival.keys: rival for rival in [*fits, base]}
    # one that holds all of the chosen one and more is no stand-in for it
    rivals = [rival for rival in fits if not set(rival.keys) >= set(chosen.keys)]
    outcome.group = _alike(rivals, chosen, None, court.scale)
    return [chosen, *outcome.group][:BEAM]


def _together(outcome: Search) -> list[Judged]:
    """Pairs that gain beside the model as it is, where none joins it alone."""
    base, court = outcome.base, outcome.court
    along = followed(base.model, court.data, base.errors, court.last)
    judged_pairs = [] if along is None else pairs(base, sorted(outcome.proposed), along, court)
    outcome.every |= {pair.keys: pair for pair in judged_pairs}
    return judged_pairs


def exchanged(
    outcome: Search, beam: list[Judged], wanted: Wanted, viable: set[Key] | None
) -> list[Judged]:
    """The beam, led by what leaves less than the best structure with another effect in the place of
    one of its own.

    What joined first was the best beside nothing: it stands for two effects that gain together
    only, until both are there.
    """
    smaller = [with_only(outcome, set(outcome.best.keys) - {key}) for key in outcome.best.keys]
    parents = [parent for parent in smaller if parent is not None]
    ranked = _fitted(outcome, _glances(outcome, parents, wanted, viable))
    before, scale = outcome.best, outcome.court.scale
    # a rarer effect would have to earn its place, which an exchange does not ask
    better = [
        rival for rival in ranked if rival.cost < before.cost and rival.rarity <= before.rarity
    ]
    if not better:
        return beam
    outcome.best = simplest([before, *better], scale)
    rivals = sorted([before, *ranked, *outcome.group], key=lambda rival: rival.cost)
    outcome.group = _alike(rivals, outcome.best, None, scale)
    return _led_by(outcome.best, beam)


def _led_by(best: Judged, beam: Sequence[Judged]) -> list[Judged]:
    """The beam with the best structure before all others."""
    return [best, *(rival for rival in beam if rival is not best)][:BEAM]


# Longer windows, where the best structure follows them now.


def lengthened(outcome: Search) -> list[Judged]:
    """The beam on the longest windows up to which the best one follows all now; base and beam are
    judged there from now on. Empty where it does not follow the next longer ones.

    What looked best on short windows goes with those that stood beside it: a second store of heat
    is a loss until it is full.
    """
    beam: list[Judged] = []
    longer = _on_next_windows(outcome)
    while longer:
        beam = longer
        longer = _on_next_windows(outcome)
    return beam


def _on_next_windows(outcome: Search) -> list[Judged]:
    """The beam on the next longer windows."""
    data, court = outcome.court.data, outcome.court
    longer = [rung for rung in data.rungs if rung.windows < court.last.windows]
    if court.scale.nats or not longer:
        return []
    rung = longer[0]
    base = _base_on(rung, outcome)
    if base is None:
        return []
    scale, first = base
    like = [
        rival
        for rival in outcome.every.values()
        if len(rival.keys) == len(outcome.best.keys) and rival is not outcome.best
    ]
    tasks = [outcome.best, *sorted(like, key=lambda rival: rival.cost)[: 2 * BEAM]]
    refits = each_beside(lambda rival: _on_longer_windows(rival, rung, scale, outcome), tasks)
    ranked = sorted((rival for rival in refits if rival is not None), key=lambda rival: rival.cost)
    if not ranked:
        return []
    outcome.court = replace(court, last=rung, scale=scale)
    outcome.base = first
    outcome.best = simplest(ranked, scale)
    # errors on other windows compare with none of these
    outcome.every = {(): first} | {rival.keys: rival for rival in ranked}
    outcome.group = _alike(ranked, outcome.best, None, scale)
    return _led_by(outcome.best, going_on(ranked, scale))


def _base_on(rung: Rung, outcome: Search) -> tuple[Scale, Judged] | None:
    """The model as it is on a rung, and the scale in which its power is one; None where it
    diverges.
    """
    data = outcome.court.data
    flat = plain(data)
    fit = fitted(data.model, rung, None, flat, steps=15, tolerance=1e-4)
    if fit is None:
        return None
    scale = clipped(flat, fit.residuals, rung)
    structure = outcome.base.structure.at(rung, fit)
    base = judged(structure, fit.in_unit(scale).descended(6, 1e-4), rung, data, scale)
    if base is None:
        return None
    scale = of_power(scale, data, base.power)
    return scale, replace(base, cost=scale.cost(base.power, base.parameters))


def _on_longer_windows(
    candidate: Judged, rung: Rung, scale: Scale, outcome: Search
) -> Judged | None:
    """A structure fitted and judged on longer windows; None where it does not follow them, or shows
    less than an unknown load.
    """
    # in units of the outputs' spread, in which following is counted
    flat = plain(outcome.court.data)
    fit = fitted(candidate.model, rung, None, flat, steps=15, tolerance=1e-4)
    if fit is None or fit.mean > RUNG_ERROR:
        return None
    fit = fit.in_unit(scale).descended(6, 1e-4)
    if outcome.along is not None and not shows(fit.model, outcome.along, rung):
        return None
    return judged(candidate.structure.at(rung, fit), fit, rung, outcome.court.data, scale)
