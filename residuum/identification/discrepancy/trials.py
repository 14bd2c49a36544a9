"""Trials: the candidates that promise something on top of a structure, re-estimated in full from every start worth it."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.evidence import ALIKE
from residuum.identification.discrepancy.score_test import FAR_BEHIND, Screen, Screened
from residuum.identification.discrepancy.side_by_side import side_by_side
from residuum.identification.discrepancy.structures import (
    NO_RIVAL,
    NOISE_ALONE,
    Rival,
    Structure,
    glimpse,
    refit,
    root_mean_squares,
    times_its_innovations,
)
from residuum.identification.physics import Experiment, PhysicalModel, Simulator, candidates, conditions_at
from residuum.identification.physics.effects.base import Conditions, Effect
from residuum.identification.physics.model import find_effect

FloatArray = npt.NDArray[np.float64]

MOST_GLIMPSES, SECOND_LOOKS = 3, 2
POLISHES, CLOSE = 3, 20.0
WORTH_A_LOOK = 1.02
"""Factor by which the outputs' errors may rise, in the mean of their logarithms, with an effect that is looked at."""
SLOW = 10.0
"""Times its innovations from which on an error is slow."""
ACCEPT = 3.0
"""Evidence above the number of candidates' logarithm at which an effect joins a structure: odds of 20 to 1."""
NOTHING_LEFT = 1.5
"""Times its innovations up to which an error is all noise."""
_WELL = 0.01
"""Share of the likeliest effect's gain from which on an effect fits well enough to be generalised."""
LOWER_TOP = 100.0
"""Log-likelihood by which a lower top can lie behind."""
SHIFTS = {"input-delay": "delay", "output-lag": "tau"}
"""Effects that shift signals in time, and their parameters that say by how much."""


def trials(
    screen: Screen, pairs: Sequence[tuple[str, str]], refits: int
) -> tuple[dict[tuple[str, str], Structure], list[Screened]]:
    """Candidates that promise something on top of what was screened, re-estimated in full; and all as they were screened."""
    best, experiments = screen.base, screen.experiments
    screen.test_all(pairs)
    tested = [screened for screened in (screen.best(*pair) for pair in pairs) if screened is not None]
    tested.sort(key=lambda s: -s.gain)
    lowest = -FAR_BEHIND if times_its_innovations(best) < NOISE_ALONE else -np.inf
    refitted = _refitted(screen, [s.start for s in tested if s.gain > 2.0][:refits])
    negative = [s for s in tested if lowest < s.gain < 0.0]
    without_zero = [s for s in negative[MOST_GLIMPSES:] if not find_effect(s.effect).vanishes or _has_states(best.model, s.key)]
    doubted = [[s.start for s in (*negative[:MOST_GLIMPSES], *without_zero)]]
    if times_its_innovations(best) > SLOW:
        doubted += [_from_the_track(screen, pairs)[:MOST_GLIMPSES], _with_states(screen, pairs)]
    refitted = _likelier(refitted, _refitted(screen, _overlooked(screen, doubted, refitted), _rival(refitted.values())))
    refitted = _likelier(refitted, _grown(screen, pairs, refitted))
    refitted |= _simplified(screen, refitted)
    return that_say_more(_settled(refitted, best, experiments)), tested


def that_say_more(refitted: dict[tuple[str, str], Structure]) -> dict[tuple[str, str], Structure]:
    """All but effects whose estimate is that of a special one that lies near: where a machine sticks and slides the likelihood
    has steps, and a top is higher by chance alone.
    """
    found = dict(refitted)
    for (id, target), general in refitted.items():
        special = refitted.get((find_effect(id).generalises, target))
        if special is None or special is general or special.log_likelihood < general.log_likelihood - LOWER_TOP:
            continue
        label = f"{general.label_of((id, target))}."
        values = {n.removeprefix(label): v for n, v in general.model.values.items() if n.startswith(label)}
        doubts = dict(zip(general.parameters, general.std.tolist(), strict=True))
        std = {n: doubts.get(f"{label}{n}", 0.0) for n in values}
        if not find_effect(id).says_more(values, std):
            del found[id, target]
    return found


def _settled(
    refitted: dict[tuple[str, str], Structure], best: Structure, experiments: Sequence[Experiment]
) -> dict[tuple[str, str], Structure]:
    """Structures that lie close are climbed to their tops before they are compared: the order must not be that of haste."""
    score = {key: schwarz(s, best) for key, s in refitted.items()}
    highest = max(score.values(), default=0.0)
    close = [key for key in score if score[key] > max(highest - CLOSE, best.log_likelihood)]
    tops = side_by_side(lambda key: polished(refitted[key], experiments), close) if len(close) > 1 else []
    return refitted | dict(zip(close, tops, strict=False))


def _refitted(screen: Screen, starts: Sequence[PhysicalModel], rival: Rival = NO_RIVAL) -> dict[tuple[str, str], Structure]:
    """Every start that was not before re-estimated in full, the likeliest of each candidate.

    Without a `rival` for them to come near the first is one for the others.
    """
    best, experiments = screen.base, screen.experiments
    new = screen.not_refitted(starts)
    screen.refitted += new
    structures = [refit(best, start, experiments) for start in new[:1] if rival.log_likelihood == -np.inf]
    nearest = _rival([s for s in structures if s is not None]) if structures else rival
    structures += side_by_side(lambda start: refit(best, start, experiments, rival=nearest), new[len(structures) :])
    found: dict[tuple[str, str], Structure] = {}
    for start, structure in zip(new, structures, strict=True):
        key = _key(start)
        if structure is not None and (within_a_sample(structure, key, experiments) or _is_sound(structure, key, screen)):
            found = _likelier(found, {key: structure})
    return found


def _rival(structures: Collection[Structure]) -> Rival:
    """The likeliest of several; and the errors of those as likely that leave nothing but noise: they are at their tops, and
    others have to come near them.
    """
    highest = max((s.log_likelihood for s in structures), default=-np.inf)
    done = [s for s in structures if _is_done(s, highest)]
    return Rival(highest, np.min([root_mean_squares(s.residuals) for s in done], axis=0) if done else None)


def _is_done(structure: Structure, highest: float) -> bool:
    """Whether a structure is about as likely as the likeliest, and leaves nothing but noise."""
    return structure.log_likelihood > highest - CLOSE and times_its_innovations(structure) < NOTHING_LEFT


def _key(start: PhysicalModel) -> tuple[str, str]:
    """The candidate that a start is one of."""
    return start.effects[-1].id, start.effects[-1].target


def _likelier(
    found: Mapping[tuple[str, str], Structure], others: Mapping[tuple[str, str], Structure]
) -> dict[tuple[str, str], Structure]:
    """The likelier structure of each candidate."""
    more = {key: s for key, s in others.items() if key not in found or s.log_likelihood > found[key].log_likelihood}
    return {**found, **more}


def followed(screen: Screen, key: tuple[str, str], structure: Structure) -> Structure:
    """The structure climbed to its top, or a likelier top from another start of its effect: a contact's likelihood has many."""
    experiments = screen.experiments
    tops = [polished(structure, experiments)]
    if len(screen.starts(*key)) > 1:
        starts = [screened.start for screened in screen.promising(*key)]
        tops += _refitted(screen, starts, _rival(tops)).values()
        tops += _grown(screen, [key], {key: tops[0]}).values()
    best = max(tops, key=lambda s: s.log_likelihood)
    return _placed(best if best is tops[0] else polished(best, experiments), key, screen)


def _placed(structure: Structure, key: tuple[str, str], screen: Screen) -> Structure:
    """The structure with what the effect holds fixed (where a spring is at rest) as in its first start, where the data allow it.

    From elsewhere the same curve may be had by a weight that leans, and then a friction that leans the other way is found.
    """
    label, known = structure.label_of(key), structure.model.all_parameters
    held = [n for n, p in known.items() if p.fixed and n.startswith(f"{label}.")]
    first = {f"{label}.{n}": value for n, value in screen.starts(*key)[0].items()} if held else {}
    place = {n: first[n] for n in held if n in first and known[n].value != first[n]}
    if not place:
        return structure
    other = refit(structure, structure.model.with_values(place), screen.experiments)
    return structure if other is None or other.log_likelihood < structure.log_likelihood - ALIKE else other


def polished(structure: Structure, experiments: Sequence[Experiment]) -> Structure:
    """The structure climbed to its top: what it does not follow exactly would invite a next effect that is not there."""
    for _ in range(0 if structure.at_top else POLISHES):
        better = refit(structure, structure.model, experiments)
        if better is None or better.log_likelihood < structure.log_likelihood + 1.0:
            break
        structure = better
    return replace(structure, at_top=True)


def _grown(
    screen: Screen, pairs: Sequence[tuple[str, str]], refitted: Mapping[tuple[str, str], Structure]
) -> dict[tuple[str, str], Structure]:
    """Effects that generalise one that fits well, refitted from its estimate: from nothing they may not be reached."""
    best, experiments, rival = screen.base, screen.experiments, _rival(refitted.values())
    well = max(ACCEPT, _WELL * (rival.log_likelihood - best.log_likelihood))
    starts: list[tuple[PhysicalModel, Sequence[FloatArray]]] = []
    for id, target in pairs:
        special = refitted.get((find_effect(id).generalises, target))
        if special is None or special.log_likelihood - best.log_likelihood < well:
            continue
        known = best.model.with_values({n: v for n, v in special.model.values.items() if n in best.model.all_parameters})
        initial = special.initial if find_effect(id).generalises == id else best.initial
        each = _grown_starts(id, target, special, experiments)
        starts += [(known.with_effect(id, target, values), initial) for values in each]
    structures = side_by_side(lambda one: refit(best, one[0], experiments, initial=one[1], rival=rival), starts)
    found: dict[tuple[str, str], Structure] = {}
    for (model, _), structure in zip(starts, structures, strict=True):
        key = _key(model)
        if structure is not None and _is_sound(structure, key, screen):
            found = _likelier(found, {key: structure})
    return found


def _simplified(screen: Screen, refitted: Mapping[tuple[str, str], Structure]) -> dict[tuple[str, str], Structure]:
    """Effects refitted from the estimate of one that generalises them, where that one does better: they may have been stuck, or
    not been among the likeliest to first order.
    """
    best, experiments = screen.base, screen.experiments
    found: dict[tuple[str, str], Structure] = {}
    for (id, target), general in refitted.items():
        key = find_effect(id).generalises, target
        special, label = found.get(key, refitted.get(key)), general.label_of((id, target))
        reached = best.log_likelihood + ACCEPT if special is None else schwarz(special, best)
        if key not in candidates(best.model, [key[0]] if key[0] else []) or schwarz(general, best) <= reached:
            continue
        own = {n.removeprefix(f"{label}."): v for n, v in general.model.values.items() if n.startswith(f"{label}.")}
        values = find_effect(id).specialised(own, screen.conditions(find_effect(id), target))
        if not values:
            continue
        known = {n: v for n, v in general.model.values.items() if n in best.model.all_parameters}
        again = refit(best, best.model.with_values(known).with_effect(*key, values), experiments, initial=general.initial)
        higher = again is not None and (special is None or again.log_likelihood > special.log_likelihood)
        if again is not None and higher and _is_sound(again, key, screen):
            found[key] = again
    return found


def _grown_starts(id: str, target: str, special: Structure, experiments: Sequence[Experiment]) -> Sequence[Mapping[str, float]]:
    longest = int(np.argmax([e.n for e in experiments]))
    effect = find_effect(id)
    return effect.grown(*_at_estimate(special, (effect.generalises, target), experiments, longest, effect))


def _is_sound(structure: Structure, key: tuple[str, str], screen: Screen) -> bool:
    """Whether an effect leaves no larger simulation error, and can be told from an unknown load."""
    return simulates_no_worse(structure, screen.base) and _shows(structure, key, screen.experiments)


def _shows(structure: Structure, key: tuple[str, str], experiments: Sequence[Experiment]) -> bool:
    """Whether in one of the experiments the effect, as it was estimated, can be told from an unknown load."""
    effect = find_effect(key[0])
    if type(effect).shows is Effect.shows:
        return True
    longest_first = sorted(range(len(experiments)), key=lambda k: -experiments[k].n)
    return any(effect.shows(*_at_estimate(structure, key, experiments, k)) for k in longest_first)


def _at_estimate(
    structure: Structure, key: tuple[str, str], experiments: Sequence[Experiment], k: int, beside: Effect | None = None
) -> tuple[dict[str, float], Conditions]:
    """An effect's values where it was estimated, and the conditions for it (or one `beside` it) in the k-th experiment."""
    simulator = Simulator(structure.model)
    X = simulator.run_vectors(experiments[k], structure.initial[k], simulator.p(), substeps=structure.substeps[k]).X
    label = f"{structure.label_of(key)}."
    values = {n.removeprefix(label): v for n, v in structure.model.values.items() if n.startswith(label)}
    return values, conditions_at(structure.model, beside or find_effect(key[0]), key[1], experiments[k], X)


def _overlooked(
    screen: Screen, doubted: Sequence[Sequence[PhysicalModel]], refitted: Mapping[tuple[str, str], Structure]
) -> list[PhysicalModel]:
    """Of several lists of starts those that a few full steps speak for, the most promising of each.

    The first-order test misjudges effects where its linearisation fails: it finds a negative gain, which a least-squares step can
    only cause there, or none at all.

    Where what was `refitted` leaves nothing but noise others have to come near its error, else near what there was before.
    """
    rival = _rival(refitted.values())
    done = [key for key, s in refitted.items() if _is_done(s, rival.log_likelihood)]
    if rival.errors is None:
        rival = replace(rival, errors=root_mean_squares(screen.base.residuals))

    def gain(start: PhysicalModel) -> float:
        there = screen.where(start)
        return glimpse(start, there.experiments, there.base, there.most_substeps, rival) - there.base.log_likelihood

    new = [[start for start in screen.not_refitted(one) if _key(start) not in done] for one in doubted]
    starts = {id(start): start for one in new for start in one}
    gains = dict(zip(starts, side_by_side(gain, list(starts.values())), strict=True))
    found = [sorted((s for s in one if gains[id(s)] > 2.0), key=lambda s: -gains[id(s)])[:SECOND_LOOKS] for one in new]
    return list({id(start): start for one in found for start in one}.values())


def _from_the_track(screen: Screen, pairs: Sequence[tuple[str, str]]) -> list[PhysicalModel]:
    """Starts of the effects that resemble what their balances lacked where the machine was, the most alike first."""
    found = [regressed for regressed in side_by_side(lambda pair: screen.regressed(*pair), pairs) if regressed is not None]
    return [model for _, model in sorted(found, key=lambda one: -one[0])]


def _with_states(screen: Screen, pairs: Sequence[tuple[str, str]]) -> list[PhysicalModel]:
    """Starts of the effects with states of their own: no track shows those, and slow noise hides what they would explain."""
    own = [pair for pair in pairs if _has_states(screen.base.model, pair)]
    return [screened.start for pair in own for screened in screen.promising(*pair, most=2)]


def _has_states(model: PhysicalModel, key: tuple[str, str]) -> bool:
    """Whether an effect remembers: play, a second store, hysteresis."""
    effect = find_effect(key[0])
    return bool(effect.states(model.site(key[1], effect)))


def within_a_sample(structure: Structure, key: tuple[str, str], experiments: Sequence[Experiment]) -> bool:
    """Whether an effect is a shift in time by less than a sample."""
    shift = structure.model.values.get(f"{structure.label_of(key)}.{SHIFTS.get(key[0], '')}", np.inf)
    return bool(shift < max(e.sample_time for e in experiments))


def simulates_no_worse(structure: Structure, before: Structure, rise: float = WORTH_A_LOOK) -> bool:
    """Whether the simulation error fell too: noise that is nearly integrated can swallow any slow error."""
    return mean_ratio(structure.rmse, before.rmse) < rise


def mean_ratio(after: FloatArray, before: FloatArray) -> float:
    """Geometric mean over the outputs of the ratio of their errors."""
    return float(np.exp(np.nanmean(np.log(after / before))))


def schwarz(structure: Structure, base: Structure) -> float:
    """Schwarz's criterion."""
    return structure.log_likelihood - structure.penalty(base)
