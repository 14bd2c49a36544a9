"""The beam search: effects join one after the other, and ties travel, since what is one effect
alone may be told apart beside another.

At every level each proposal beside each structure of the beam is fitted quickly, the best of every
kind of quick fit are fitted fully and judged on unseen blocks, and the simplest within chance of
the best leads. After each effect that joined, the unit of the error is asked again.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from residuum.identification.physics import Key, PhysicalModel
from residuum.identification.side_by_side import each_beside
from residuum.identification.unseen_blocks.comparing import (
    all_alike,
    corrected,
    going_on,
    is_nothing,
    real_ones,
    simpler_ones,
    simplest,
)
from residuum.identification.unseen_blocks.cross_validation import (
    CrossValidation,
    ValidatedFit,
    validated,
)
from residuum.identification.unseen_blocks.following import Track, followed
from residuum.identification.unseen_blocks.multiple_shooting import (
    first_fit,
    first_fit_at_likelier_timing,
)
from residuum.identification.unseen_blocks.pairs import pairs
from residuum.identification.unseen_blocks.policy import (
    BEAM,
    DEEPEST,
    EXCHANGED,
    EXCHANGED_IN_NOISE,
    FOLLOWED,
    FOLLOWED_ERROR,
    FULLY_FITTED,
    NEAR_NOISE,
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
from residuum.identification.unseen_blocks.trial_fits import (
    QuickFit,
    at_other_places,
    best_of_each,
    fit_from,
    full_fit_or_left_out,
    quick_fit,
    refined,
    shows,
    with_unseen_states,
    worth_beside_others,
)
from residuum.identification.unseen_blocks.tried import (
    Search,
    Wanted,
    at_the_timing_it_suits,
    begun,
    exchange,
    in_its_own_noise,
    resolved,
    settle,
    validated_in_nats,
    with_only,
    without_needless,
)
from residuum.identification.work import OutOfWork, Tell, go_on, left_out, untold

if TYPE_CHECKING:
    from residuum.identification.unseen_blocks.data import Data, Horizon

# Whether an effect joins what was found: forward selection. After every step it floats back:
# `without_needless`.


def joins(outcome: Search, ranked: list[ValidatedFit]) -> bool:
    """Whether any is real; the simplest of the best that are is the best from now on.

    One whose own modes ask for finer integration steps is judged with these, in the place of what
    it was among those `ranked`.
    """
    scale, before = outcome.validation.scale, outcome.best
    while True:
        real = real_ones(ranked, before, outcome.base, scale, outcome.tried)
        real = real or _leaving_noise(outcome, ranked) or simpler_ones(ranked, before)
        if not real:
            return False
        chosen = simplest(real, scale)
        finer = resolved(chosen, before, outcome.validation)
        if finer is chosen:
            break
        exchange(outcome, ranked, chosen, finer)
    outcome.best = chosen
    outcome.group = all_alike(ranked, chosen, before, scale)
    return True


def _leaving_noise(outcome: Search, ranked: Sequence[ValidatedFit]) -> list[ValidatedFit]:
    """The simplest of the best, where it leaves nothing but noise and is real in nats of that: what
    acts seldom, a limit that is rarely met, is ahead in few blocks alone.
    """
    if outcome.validation.scale.nats or not ranked:
        return []
    chosen = simplest(ranked, outcome.validation.scale)
    if chosen.cost >= outcome.best.cost:
        return []
    in_noise = validated_in_nats(chosen, outcome.validation)
    if in_noise is None:
        return []
    validation, in_nats = in_noise
    before = validation.validate(outcome.best.structure, steps=15, tolerance=1e-6)
    if before is None:
        return []
    gain = before.cost - in_nats.cost
    # the logarithm of how many were tried is the price of the choice among them (Bonferroni)
    worth = np.log(max(outcome.tried, 1)) + TIE
    return [] if gain < worth or corrected(in_nats, before) < TWICE else [chosen]


# Effects of which one is a special case of another: each is tried from where the other one fits.


def related(
    outcome: Search,
    by_keys: Mapping[tuple[Key, ...], ValidatedFit],
    quick_fits: Collection[QuickFit],
) -> dict[tuple[Key, ...], ValidatedFit]:
    """Effects that generalise one of the best, or are it with many minima side by side, followed
    from where that one fits, and special cases from where the general one does. From nothing they
    may not be reached, or end on the way; and what joined first as the general case may be a
    special one beside another. And the effect of the best one at its other places, fitted fully.
    """
    leading = sorted(by_keys.values(), key=lambda lead: lead.cost)[:BEAM]
    tasks = [task for lead in leading for task in _relatives(lead, outcome, quick_fits)]
    for lead in leading[:1]:
        tasks += at_other_places(lead, by_keys, quick_fits, outcome.validation)
    better: dict[tuple[Key, ...], ValidatedFit] = {}
    for fit in each_beside(lambda task: task(), tasks):
        if fit is None:
            continue
        known = better.get(fit.keys, by_keys.get(fit.keys))
        if known is None or fit.seen_cost < known.seen_cost:
            better[fit.keys] = fit
    return better


def _relatives(
    lead: ValidatedFit, outcome: Search, quick_fits: Collection[QuickFit]
) -> list[Callable[[], ValidatedFit | None]]:
    """The fits of what is related to the effects of a structure, to be made."""
    general = [trial for trial in quick_fits if trial.is_of(lead, generalised(trial.key))]
    special = [trial for trial in quick_fits if trial.is_special_case_in(lead)]
    # special cases that were proposed and are not among these quick fits: they were tried alone,
    # at another level, and nobody asked for them beside what has joined since
    elsewhere = outcome.proposed.difference(lead.keys, (trial.key for trial in special))
    replaceable = [key for key in lead.keys if special_of(key) in elsewhere]
    if not (general or special or replaceable):
        return []
    along = followed(lead.model, outcome.validation.data, lead.errors, outcome.validation.last)
    if along is None:
        return []
    return [
        *_fits_from(grown, general, along, lead, outcome),
        *_fits_from(specialised, special, along, lead, outcome),
        *(partial(_in_place, lead.structure, key, along, outcome) for key in replaceable),
    ]


def _fits_from(
    first_models: Callable[[Key, Track], list[PhysicalModel]],
    trials: Sequence[QuickFit],
    along: Track,
    lead: ValidatedFit,
    outcome: Search,
) -> list[Callable[[], ValidatedFit | None]]:
    """Full fits of proposals near a structure, begun where its own effect leads."""
    begins = [(trial, first_models(trial.key, along)) for trial in trials]
    near, validation = lead.structure, outcome.validation
    return [
        partial(fit_from, models, trial, near, validation) for trial, models in begins if models
    ]


def _in_place(whole: Structure, key: Key, along: Track, outcome: Search) -> ValidatedFit | None:
    """The structure with the special case in the place of an effect, where it was not tried."""
    special = special_of(key)
    if special is None:
        return None
    keys, models = tuple(sorted({*whole.keys, special} - {key})), specialised(special, along)
    if keys in outcome.every or not models:
        return None
    return outcome.validation.validate(
        replace(whole, keys=keys, model=models[0]), steps=15, tolerance=1e-6
    )


# The beam search itself.


@dataclass(eq=False)
class _Beam:
    """How far a beam search is: beside which `structures` effects are tried at the next level, with
    how many at most, `depth`.

    `viable` are the proposals worth a quick fit beside others (None: the first level chooses them);
    `together` pairs that were fitted for the next level; `enough` what was found when next to
    nothing of the first error was left.
    """

    outcome: Search
    wanted: Wanted
    tell: Tell
    structures: list[ValidatedFit]
    viable: set[Key] | None = None
    depth: int = 0
    together: list[ValidatedFit] = field(default_factory=list)
    enough: Search | None = None

    @property
    def nothing(self) -> bool:
        """Whether next to nothing of the first error is left."""
        return is_nothing(self.outcome.best, self.outcome.base, self.outcome.validation.scale)

    @property
    def answer(self) -> Search:
        """What was found: what joined below next to nothing counts only where it left noise
        alone.
        """
        in_noise = self.outcome.validation.scale.nats
        return self.outcome if self.enough is None or in_noise else self.enough

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
    outcome = begun(first_fit_at_likelier_timing(data) if turns == TURNS else first_fit(data))
    beam = _Beam(outcome, wanted, tell, [outcome.best])
    try:
        going = True
        while going:
            ranked = _next_level(beam)
            if ranked and joins(outcome, ranked):
                without_needless(outcome)
                ranked = in_its_own_noise(outcome, ranked)
                # asked before anything else is tried beside it: all of that would be tried anew
                retimed = at_the_timing_it_suits(outcome) if turns else None
                if retimed is not None:
                    return search(retimed, wanted, tell, turns=turns - 1)
                _go_deeper(beam, ranked)
            else:
                going = _go_on_otherwise(beam, ranked)
        if outcome.validation.scale.nats and outcome.best.keys:
            settle(outcome)
    except OutOfWork:
        left_out(f"effects {_beside(outcome.best.keys)}")
    return beam.answer


def _next_level(beam: _Beam) -> list[ValidatedFit]:
    """What was tried beside the structures of the beam, fitted and judged, the best first; nothing
    where no more is sought.
    """
    outcome = beam.outcome
    beam.progress(0.0)
    _lengthen_what_leaves_nothing(beam)
    nothing = beam.nothing
    if nothing and beam.enough is None:
        beam.enough = replace(outcome, every=dict(outcome.every), group=list(outcome.group))
    near_noise = outcome.best.cost < NEAR_NOISE * outcome.validation.scale.floor
    if beam.depth >= DEEPEST or (nothing and not near_noise):
        return []
    quick_fits = _quick_fits(outcome, beam.structures, beam.wanted, beam.viable)
    if beam.viable is None:
        beam.viable = worth_beside_others(quick_fits)
    beam.progress(0.5)
    ranked = [*_fitted(outcome, quick_fits), *beam.together]
    beam.together = []
    outcome.tried = len(quick_fits) or outcome.tried
    return sorted(ranked, key=lambda rival: rival.cost)


def _lengthen_what_leaves_nothing(beam: _Beam) -> None:
    """What leaves next to nothing in short windows may leave much in long ones."""
    while beam.nothing and beam.outcome.best.keys:
        longer = lengthened(beam.outcome)
        if not longer:
            return
        beam.structures = longer
        beam.progress(0.0)


def _go_deeper(beam: _Beam, ranked: Sequence[ValidatedFit]) -> None:
    """The structures of the next level, where an effect joined."""
    outcome = beam.outcome
    beam.structures = next_beam(outcome, ranked)
    beam.depth += 1
    # of two effects in power each was tried alone, so an exchange has nothing new to find
    fewest = EXCHANGED_IN_NOISE if outcome.validation.scale.nats else EXCHANGED
    if len(outcome.best.keys) >= fewest:
        beam.structures = exchanged(outcome, beam.structures, beam.wanted, beam.viable)


def _go_on_otherwise(beam: _Beam, ranked: Sequence[ValidatedFit]) -> bool:
    """Where nothing joined: whether to go on, on longer windows, or with pairs of effects where
    none joined the model as it is.
    """
    outcome = beam.outcome
    if outcome.best.keys and not beam.nothing:
        longer = lengthened(outcome)
        if longer:
            beam.structures = longer
            return True
    if ranked and beam.depth == 0 and not outcome.validation.scale.nats:
        beam.structures = going_on(ranked, outcome.validation.scale)
        beam.depth += 1
        beam.together = _together(outcome)
        return True
    return False


def _beside(keys: Sequence[Key]) -> str:
    return "beside " + " and ".join(key.effect for key in keys) if keys else "beside nothing else"


def _quick_fits(
    outcome: Search, parents: Sequence[ValidatedFit], wanted: Wanted, viable: set[Key] | None
) -> list[QuickFit]:
    """A quick fit of every proposal beside every one of the structures."""
    validation, data = outcome.validation, outcome.validation.data
    tasks: list[Callable[[], QuickFit | None]] = []
    queued: set[tuple[Key, ...]] = set()
    for parent in parents:
        along = followed(parent.model, data, parent.errors, validation.last)
        if along is None:
            continue
        outcome.along = along if outcome.along is None else outcome.along
        begins = with_unseen_states(parent.structure, along, validation)
        # what is missing may have driven the fitted values of the model as it is far away; what
        # joined has drawn them back
        given = None if parent.keys else followed(data.model, data)
        for key in _proposals_beside(parent, along, wanted, viable):
            keys = tuple(sorted((*parent.keys, key)))
            # {A} beside B and {B} beside A are one structure
            if keys not in queued and keys not in outcome.every:
                queued.add(keys)
                tasks.append(partial(_quick_fit_or_left_out, begins, key, along, validation, given))
    trials = [trial for trial in each_beside(lambda task: task(), tasks) if trial is not None]
    outcome.proposed |= {trial.key for trial in trials}
    return trials


def _proposals_beside(
    parent: ValidatedFit, along: Track, wanted: Wanted, viable: set[Key] | None
) -> list[Key]:
    """What may join a structure, of those that are viable."""
    keys = proposed(parent.model, wanted.effects, along, learned=wanted.learned, held=wanted.held)
    return [key for key in keys if key not in parent.keys and (viable is None or key in viable)]


def _quick_fit_or_left_out(
    parent: Structure, key: Key, along: Track, validation: CrossValidation, given: Track | None
) -> QuickFit | None:
    try:
        go_on()
        return quick_fit(parent, key, along, validation, given)
    except OutOfWork:
        left_out(f"{key.effect}@{key.target}")
        return None


def _fitted(outcome: Search, quick_fits: Collection[QuickFit]) -> list[ValidatedFit]:
    """The best of each kind of quick fit refined, the best of these fitted fully and judged, with
    those related to the best of them; the best first.
    """
    # errors after one step rank roughly, a full fit is dear: so two steps more for some, and full
    # fits for the best of those
    near = each_beside(refined, best_of_each(quick_fits, FOLLOWED))
    best = best_of_each(near, FULLY_FITTED)
    fits = each_beside(lambda trial: full_fit_or_left_out(trial, outcome.validation), best)
    by_keys = {rival.keys: rival for rival in fits if rival is not None}
    by_keys |= related(outcome, by_keys, quick_fits)
    outcome.every |= by_keys
    return sorted(by_keys.values(), key=lambda rival: rival.cost)


def next_beam(outcome: Search, ranked: Sequence[ValidatedFit]) -> list[ValidatedFit]:
    """The beam for the next level; where the unit of the error turned, its structures judged
    anew.
    """
    in_noise = None
    if not outcome.validation.scale.nats:
        in_noise = validated_in_nats(outcome.best, outcome.validation)
    if in_noise is None:
        beam = going_on(ranked, outcome.validation.scale)
        return beam if outcome.best in beam else [outcome.best, *beam[:-1]]
    validation, best = in_noise
    # costs in power and in nats have nothing in common: all that stays is judged in the new unit
    again = [rival for rival in ranked if rival.keys != best.keys][: 2 * BEAM]
    refits = [validation.validate(rival.structure, steps=15, tolerance=1e-6) for rival in again]
    fits = [best, *(fit for fit in refits if fit is not None)]
    base = validation.validate(outcome.base.structure, steps=15, tolerance=1e-6) or outcome.base
    chosen = simplest(fits, validation.scale)
    outcome.validation, outcome.best, outcome.base = validation, chosen, base
    outcome.every = {rival.keys: rival for rival in [*fits, base]}
    # one that holds all of the chosen one and more is no stand-in for it
    rivals = [rival for rival in fits if not set(rival.keys) >= set(chosen.keys)]
    outcome.group = all_alike(rivals, chosen, None, validation.scale)
    return [chosen, *outcome.group][:BEAM]


def _together(outcome: Search) -> list[ValidatedFit]:
    """Pairs that gain beside the model as it is, where none joins it alone."""
    base, validation = outcome.base, outcome.validation
    along = followed(base.model, validation.data, base.errors, validation.last)
    validated_pairs = (
        [] if along is None else pairs(base, sorted(outcome.proposed), along, validation)
    )
    outcome.every |= {pair.keys: pair for pair in validated_pairs}
    return validated_pairs


def exchanged(
    outcome: Search, beam: list[ValidatedFit], wanted: Wanted, viable: set[Key] | None
) -> list[ValidatedFit]:
    """The beam, led by what leaves less than the best structure with another effect in the place of
    one of its own.

    What joined first was the best beside nothing: it stands for two effects that gain together
    only, until both are there.
    """
    smaller = [with_only(outcome, set(outcome.best.keys) - {key}) for key in outcome.best.keys]
    parents = [parent for parent in smaller if parent is not None]
    ranked = _fitted(outcome, _quick_fits(outcome, parents, wanted, viable))
    before, scale = outcome.best, outcome.validation.scale
    # a rarer effect would have to earn its place, which an exchange does not ask
    better = [
        rival for rival in ranked if rival.cost < before.cost and rival.rarity <= before.rarity
    ]
    if not better:
        return beam
    outcome.best = simplest([before, *better], scale)
    rivals = sorted([before, *ranked, *outcome.group], key=lambda rival: rival.cost)
    outcome.group = all_alike(rivals, outcome.best, None, scale)
    return _led_by(outcome.best, beam)


def _led_by(best: ValidatedFit, beam: Sequence[ValidatedFit]) -> list[ValidatedFit]:
    """The beam with the best structure before all others."""
    return [best, *(rival for rival in beam if rival is not best)][:BEAM]


# Longer windows, where the best structure follows them now.


def lengthened(outcome: Search) -> list[ValidatedFit]:
    """The beam on the longest windows up to which the best one follows all now; base and beam are
    judged there from now on. Empty where it does not follow the next longer ones.

    What looked best on short windows goes with those that stood beside it: a second store of heat
    is a loss until it is full.
    """
    beam: list[ValidatedFit] = []
    longer = _on_next_windows(outcome)
    while longer:
        beam = longer
        longer = _on_next_windows(outcome)
    return beam


def _on_next_windows(outcome: Search) -> list[ValidatedFit]:
    """The beam on the next longer windows."""
    data, validation = outcome.validation.data, outcome.validation
    longer = [horizon for horizon in data.horizons if horizon.windows < validation.last.windows]
    if validation.scale.nats or not longer:
        return []
    horizon = longer[0]
    base = _base_on(horizon, outcome)
    if base is None:
        return []
    scale, first = base
    like = [
        rival
        for rival in outcome.every.values()
        if len(rival.keys) == len(outcome.best.keys) and rival is not outcome.best
    ]
    tasks = [outcome.best, *sorted(like, key=lambda rival: rival.cost)[: 2 * BEAM]]
    refits = each_beside(lambda rival: _on_longer_windows(rival, horizon, scale, outcome), tasks)
    ranked = sorted((rival for rival in refits if rival is not None), key=lambda rival: rival.cost)
    if not ranked:
        return []
    outcome.validation = replace(validation, last=horizon, scale=scale)
    outcome.base = first
    outcome.best = simplest(ranked, scale)
    # errors on other windows compare with none of these
    outcome.every = {(): first} | {rival.keys: rival for rival in ranked}
    outcome.group = all_alike(ranked, outcome.best, None, scale)
    return _led_by(outcome.best, going_on(ranked, scale))


def _base_on(horizon: Horizon, outcome: Search) -> tuple[Scale, ValidatedFit] | None:
    """The model as it is on a horizon, and the scale in which its power is one; None where it
    diverges.
    """
    data = outcome.validation.data
    flat = plain(data)
    fit = fitted(data.model, horizon, None, flat, steps=15, tolerance=1e-4)
    if fit is None:
        return None
    scale = clipped(flat, fit.residuals, horizon)
    structure = outcome.base.structure.at(horizon, fit)
    base = validated(structure, fit.in_unit(scale).descended(6, 1e-4), horizon, data, scale)
    if base is None:
        return None
    scale = of_power(scale, data, base.power)
    return scale, replace(base, cost=scale.cost(base.power, base.parameters))


def _on_longer_windows(
    candidate: ValidatedFit, horizon: Horizon, scale: Scale, outcome: Search
) -> ValidatedFit | None:
    """A structure fitted and judged on longer windows; None where it does not follow them, or shows
    less than an unknown load.
    """
    # in units of the outputs' spread, in which following is counted
    flat = plain(outcome.validation.data)
    fit = fitted(candidate.model, horizon, None, flat, steps=15, tolerance=1e-4)
    if fit is None or fit.mean > FOLLOWED_ERROR:
        return None
    fit = fit.in_unit(scale).descended(6, 1e-4)
    if outcome.along is not None and not shows(fit.model, outcome.along, horizon):
        return None
    return validated(
        candidate.structure.at(horizon, fit), fit, horizon, outcome.validation.data, scale
    )
