"""Trials: the candidates that promise something on top of a structure, re-estimated in full from every start worth it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from residuum.identification.discrepancy.fitting.structure_comparison import is_done, likelier, rival_of, schwarz, within_a_sample
from residuum.identification.discrepancy.fitting.structure_fits import glimpse, refit
from residuum.identification.discrepancy.fitting.structures import (
    NO_RIVAL,
    Rival,
    Structure,
    root_mean_squares,
    times_its_innovations,
)
from residuum.identification.discrepancy.policy.acceptance import ALIKE
from residuum.identification.discrepancy.policy.likelihood import CLOSE, FAR_BEHIND, POLISH_GAIN, POLISHES
from residuum.identification.discrepancy.policy.trials import MOST_GLIMPSES, PROMISING_GAIN, SECOND_LOOKS, STARTS_WITH_STATES
from residuum.identification.discrepancy.screening.score_test import Screen, Screened
from residuum.identification.discrepancy.searching.soundness import is_sound
from residuum.identification.discrepancy.searching.special_cases import grown, simplified, that_say_more
from residuum.identification.physics import Experiment, Key, PhysicalModel
from residuum.identification.physics.model import find_effect
from residuum.identification.residual_analysis.policy.noise import NOISE_ALONE, SLOW
from residuum.identification.side_by_side import side_by_side


def trials(screen: Screen, pairs: Sequence[Key], refits: int) -> tuple[dict[Key, Structure], list[Screened]]:
    """Candidates that promise something on top of what was screened, re-estimated in full; and all as they were screened."""
    best, experiments = screen.base, screen.experiments
    screen.test_all(pairs)
    tested = [screened for screened in (screen.best(*pair) for pair in pairs) if screened is not None]
    tested.sort(key=lambda s: -s.gain)
    lowest = -FAR_BEHIND if times_its_innovations(best) < NOISE_ALONE else -np.inf
    refitted = _refitted(screen, [s.start for s in tested if s.gain > PROMISING_GAIN][:refits])
    negative = [s for s in tested if lowest < s.gain < 0.0]
    without_zero = [s for s in negative[MOST_GLIMPSES:] if not find_effect(s.effect).vanishes or _has_states(best.model, s.key)]
    doubted = [[s.start for s in (*negative[:MOST_GLIMPSES], *without_zero)]]
    if times_its_innovations(best) > SLOW:
        doubted += [_from_the_track(screen, pairs)[:MOST_GLIMPSES], _with_states(screen, pairs)]
    refitted = likelier(refitted, _refitted(screen, _overlooked(screen, doubted, refitted), rival_of(refitted.values())))
    refitted = likelier(refitted, grown(screen, pairs, refitted))
    refitted |= simplified(screen, refitted)
    return that_say_more(_settled(refitted, best, experiments)), tested


def _settled(refitted: dict[Key, Structure], best: Structure, experiments: Sequence[Experiment]) -> dict[Key, Structure]:
    """Structures that lie close are climbed to their tops before they are compared: the order must not be that of haste."""
    score = {key: schwarz(s, best) for key, s in refitted.items()}
    highest = max(score.values(), default=0.0)
    close = [key for key in score if score[key] > max(highest - CLOSE, best.log_likelihood)]
    tops = side_by_side(lambda key: polished(refitted[key], experiments), close) if len(close) > 1 else []
    return refitted | dict(zip(close, tops, strict=False))


def _refitted(screen: Screen, starts: Sequence[PhysicalModel], rival: Rival = NO_RIVAL) -> dict[Key, Structure]:
    """Every start that was not before re-estimated in full, the likeliest of each candidate.

    Without a `rival` for them to come near the first is one for the others.
    """
    best, experiments = screen.base, screen.experiments
    new = screen.not_refitted(starts)
    screen.refitted += new
    structures = [refit(best, start, experiments) for start in new[:1] if rival.log_likelihood == -np.inf]
    nearest = rival_of([s for s in structures if s is not None]) if structures else rival
    structures += side_by_side(lambda start: refit(best, start, experiments, rival=nearest), new[len(structures) :])
    found: dict[Key, Structure] = {}
    for start, structure in zip(new, structures, strict=True):
        key = start.effects[-1].key
        if structure is not None and (within_a_sample(structure, key, experiments) or is_sound(structure, key, screen)):
            found = likelier(found, {key: structure})
    return found


def followed(screen: Screen, key: Key, structure: Structure) -> Structure:
    """The structure climbed to its top, or a likelier top from another start of its effect: a contact's likelihood has many."""
    experiments = screen.experiments
    tops = [polished(structure, experiments)]
    if len(screen.starts(*key)) > 1:
        starts = [screened.start for screened in screen.promising(*key)]
        tops += _refitted(screen, starts, rival_of(tops)).values()
        tops += grown(screen, [key], {key: tops[0]}).values()
    best = max(tops, key=lambda s: s.log_likelihood)
    return _placed(best if best is tops[0] else polished(best, experiments), key, screen)


def _placed(structure: Structure, key: Key, screen: Screen) -> Structure:
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
        if better is None or better.log_likelihood < structure.log_likelihood + POLISH_GAIN:
            break
        structure = better
    return replace(structure, at_top=True)


def _overlooked(
    screen: Screen, doubted: Sequence[Sequence[PhysicalModel]], refitted: Mapping[Key, Structure]
) -> list[PhysicalModel]:
    """Of several lists of starts those that a few full steps speak for, the most promising of each.

    The first-order test misjudges effects where its linearisation fails: it finds a negative gain, which a least-squares step can
    only cause there, or none at all.

    Where what was `refitted` leaves nothing but noise others have to come near its error, else near what there was before.
    """
    rival = rival_of(refitted.values())
    done = [key for key, s in refitted.items() if is_done(s, rival.log_likelihood)]
    if rival.errors is None:
        rival = replace(rival, errors=root_mean_squares(screen.base.residuals))

    def gain(start: PhysicalModel) -> float:
        there = screen.where(start)
        return glimpse(start, there.experiments, there.base, there.most_substeps, rival) - there.base.log_likelihood

    new = [[start for start in screen.not_refitted(one) if start.effects[-1].key not in done] for one in doubted]
    starts = {id(start): start for one in new for start in one}
    gains = dict(zip(starts, side_by_side(gain, list(starts.values())), strict=True))
    found = [sorted((s for s in one if gains[id(s)] > PROMISING_GAIN), key=lambda s: -gains[id(s)])[:SECOND_LOOKS] for one in new]
    return list({id(start): start for one in found for start in one}.values())


def _from_the_track(screen: Screen, pairs: Sequence[Key]) -> list[PhysicalModel]:
    """Starts of the effects that resemble what their balances lacked where the machine was, the most alike first."""
    found = [regressed for regressed in side_by_side(lambda pair: screen.regressed(*pair), pairs) if regressed is not None]
    return [model for _, model in sorted(found, key=lambda one: -one[0])]


def _with_states(screen: Screen, pairs: Sequence[Key]) -> list[PhysicalModel]:
    """Starts of the effects with states of their own: no track shows those, and slow noise hides what they would explain."""
    own = [pair for pair in pairs if _has_states(screen.base.model, pair)]
    return [screened.start for pair in own for screened in screen.promising(*pair, most=STARTS_WITH_STATES)]


def _has_states(model: PhysicalModel, key: Key) -> bool:
    """Whether an effect remembers: play, a second store, hysteresis."""
    effect = find_effect(key[0])
    return bool(effect.states(model.site(key[1], effect)))
