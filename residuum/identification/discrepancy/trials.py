"""Trials: the candidates that promise something on top of a structure, re-estimated in full from every start worth it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.evidence import ALIKE
from residuum.identification.discrepancy.score_test import Screen, Screened
from residuum.identification.discrepancy.side_by_side import side_by_side
from residuum.identification.discrepancy.structures import Structure, glimpse, refit
from residuum.identification.physics import Experiment, PhysicalModel, Simulator, candidates, conditions_at
from residuum.identification.physics.effects import EFFECTS
from residuum.identification.physics.effects.base import Conditions, Effect

FloatArray = npt.NDArray[np.float64]

MOST_GLIMPSES, SECOND_LOOKS = 3, 2
POLISHES, CLOSE = 3, 20.0
WORTH_A_LOOK = 1.02
"""Factor by which the outputs' errors may rise, in the mean of their logarithms, with an effect that is looked at."""
SLOW = 10.0
"""Times its innovations from which on an error is slow."""
ACCEPT = 3.0
"""Evidence above the number of candidates' logarithm at which an effect joins a structure: odds of 20 to 1."""
NOTHING_LEFT, MUCH_WORSE = 1.5, 4.0
"""Times its innovations up to which an error is all noise; factor of its mean square beyond which another is hopeless."""
SHIFTS = {"input-delay": "delay", "output-lag": "tau"}
"""Effects that shift signals in time, and their parameters that say by how much."""


def trials(
    screen: Screen, pairs: Sequence[tuple[str, str]], refits: int
) -> tuple[dict[tuple[str, str], Structure], list[Screened]]:
    """Candidates that promise something on top of what was screened, re-estimated in full; and all as they were screened."""
    best, experiments = screen.base, screen.experiments
    tested = [screened for screened in side_by_side(lambda pair: screen.best(*pair), pairs) if screened is not None]
    tested.sort(key=lambda s: -s.gain)
    refitted = _refitted(best, experiments, [s.start for s in tested if s.gain > 2.0][:refits])
    negative = [s for s in tested if s.gain < 0.0]
    without_zero = [s for s in negative[MOST_GLIMPSES:] if not EFFECTS[s.effect].vanishes or _has_states(best.model, s.key)]
    doubted = [[s.start for s in (*negative[:MOST_GLIMPSES], *without_zero)]]
    if times_its_innovations(best) > SLOW:
        doubted += [_from_the_track(screen, pairs)[:MOST_GLIMPSES], _with_states(screen, pairs)]
    overlooked = _overlooked(screen, doubted, refitted)
    refitted = _likelier(refitted, _refitted(best, experiments, overlooked, _highest(refitted)))
    for key, structure in _grown(best, experiments, pairs, refitted):
        refitted |= _likelier(refitted, {key: structure})
    refitted |= _simplified(best, experiments, refitted)
    return _settled(refitted, best, experiments), tested


def _settled(
    refitted: dict[tuple[str, str], Structure], best: Structure, experiments: Sequence[Experiment]
) -> dict[tuple[str, str], Structure]:
    """Structures that lie close are climbed to their tops before they are compared: the order must not be that of haste."""
    score = {key: schwarz(s, best) for key, s in refitted.items()}
    highest = max(score.values(), default=0.0)
    close = [key for key in score if score[key] > max(highest - CLOSE, best.log_likelihood)]
    tops = side_by_side(lambda key: polished(refitted[key], experiments), close) if len(close) > 1 else []
    return refitted | dict(zip(close, tops, strict=False))


def _refitted(
    best: Structure, experiments: Sequence[Experiment], starts: Sequence[PhysicalModel], mark: float = -np.inf
) -> dict[tuple[str, str], Structure]:
    """Every start re-estimated in full, the likeliest of each candidate.

    Without a `mark` for them to come near the first sets it for the others.
    """
    structures = [refit(best, start, experiments) for start in starts[:1] if mark == -np.inf]
    marks = [mark, *(s.log_likelihood for s in structures if s is not None)]
    structures += side_by_side(lambda start: refit(best, start, experiments, rival=max(marks)), starts[len(structures) :])
    found: dict[tuple[str, str], Structure] = {}
    for start, structure in zip(starts, structures, strict=True):
        if structure is None:
            continue
        key = _key(start)
        shorter = within_a_sample(structure, key, experiments)
        if shorter or (simulates_no_worse(structure, best) and _shows(structure, key, experiments)):
            found = _likelier(found, {key: structure})
    return found


def _key(start: PhysicalModel) -> tuple[str, str]:
    """The candidate that a start is one of."""
    return start.effects[-1].id, start.effects[-1].target


def _likelier(
    found: Mapping[tuple[str, str], Structure], others: Mapping[tuple[str, str], Structure]
) -> dict[tuple[str, str], Structure]:
    """The likelier structure of each candidate."""
    more = {key: s for key, s in others.items() if key not in found or s.log_likelihood > found[key].log_likelihood}
    return {**found, **more}


def _highest(refitted: Mapping[tuple[str, str], Structure]) -> float:
    """The highest log-likelihood."""
    return max((s.log_likelihood for s in refitted.values()), default=-np.inf)


def followed(screen: Screen, key: tuple[str, str], structure: Structure) -> Structure:
    """The structure climbed to its top, or a likelier top from another start of its effect: a contact's likelihood has many."""
    before, experiments = screen.base, screen.experiments
    tops = [polished(structure, experiments)]
    if len(screen.starts(*key)) > 1:
        starts = [screened.start for screened in screen.promising(*key)]
        tops += _refitted(before, experiments, starts).values()
        tops += [grown for _, grown in _grown(before, experiments, [key], {key: tops[0]})]
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
    for _ in range(POLISHES):
        better = refit(structure, structure.model, experiments)
        if better is None or better.log_likelihood < structure.log_likelihood + 1.0:
            break
        structure = better
    return structure


def _grown(
    best: Structure,
    experiments: Sequence[Experiment],
    pairs: Sequence[tuple[str, str]],
    refitted: Mapping[tuple[str, str], Structure],
) -> Iterator[tuple[tuple[str, str], Structure]]:
    """Effects that generalise one that fits well, refitted from its estimate: from nothing they may not be reached."""
    for id, target in pairs:
        special = refitted.get((EFFECTS[id].generalises, target))
        if special is None or special.log_likelihood - best.log_likelihood < ACCEPT:
            continue
        initial = special.initial if EFFECTS[id].generalises == id else best.initial
        for start in _grown_starts(id, target, special, experiments):
            model = best.model.with_values(
                {n: v for n, v in special.model.values.items() if n in best.model.all_parameters}
            ).with_effect(id, target, start)
            structure = refit(best, model, experiments, initial=initial, rival=_highest(refitted))
            if structure is not None and simulates_no_worse(structure, best) and _shows(structure, (id, target), experiments):
                yield (id, target), structure


def _simplified(
    best: Structure, experiments: Sequence[Experiment], refitted: Mapping[tuple[str, str], Structure]
) -> dict[tuple[str, str], Structure]:
    """Effects refitted from the estimate of one that generalises them, where that one does better: they may have been stuck, or
    not been among the likeliest to first order.
    """
    found: dict[tuple[str, str], Structure] = {}
    for (id, target), general in refitted.items():
        key = EFFECTS[id].generalises, target
        special, label = found.get(key, refitted.get(key)), general.label_of((id, target))
        reached = best.log_likelihood + ACCEPT if special is None else schwarz(special, best)
        if key not in candidates(best.model, [key[0]] if key[0] else []) or schwarz(general, best) <= reached:
            continue
        own = {n.removeprefix(f"{label}."): v for n, v in general.model.values.items() if n.startswith(f"{label}.")}
        values = EFFECTS[id].specialised(own)
        if not values:
            continue
        known = {n: v for n, v in general.model.values.items() if n in best.model.all_parameters}
        again = refit(best, best.model.with_values(known).with_effect(*key, values), experiments, initial=general.initial)
        higher = again is not None and (special is None or again.log_likelihood > special.log_likelihood)
        if again is not None and higher and simulates_no_worse(again, best) and _shows(again, key, experiments):
            found[key] = again
    return found


def _grown_starts(id: str, target: str, special: Structure, experiments: Sequence[Experiment]) -> Sequence[Mapping[str, float]]:
    return EFFECTS[id].grown(*_at_estimate(special, (EFFECTS[id].generalises, target), experiments, EFFECTS[id]))


def _shows(structure: Structure, key: tuple[str, str], experiments: Sequence[Experiment]) -> bool:
    """Whether the experiments are long enough for the effect, as it was estimated, to be told from an unknown load."""
    return not _has_states(structure.model, key) or EFFECTS[key[0]].shows(*_at_estimate(structure, key, experiments))


def _at_estimate(
    structure: Structure, key: tuple[str, str], experiments: Sequence[Experiment], beside: Effect | None = None
) -> tuple[dict[str, float], Conditions]:
    """An effect's values where it was estimated, and the conditions for it (or one `beside` it) in the longest experiment."""
    k = int(np.argmax([e.n for e in experiments]))
    simulator = Simulator(structure.model)
    X = simulator.run_vectors(experiments[k], structure.initial[k], simulator.p(), substeps=structure.substeps[k]).X
    label = f"{structure.label_of(key)}."
    values = {n.removeprefix(label): v for n, v in structure.model.values.items() if n.startswith(label)}
    return values, conditions_at(structure.model, beside or EFFECTS[key[0]], key[1], experiments[k], X)


def _overlooked(
    screen: Screen, doubted: Sequence[Sequence[PhysicalModel]], refitted: Mapping[tuple[str, str], Structure]
) -> list[PhysicalModel]:
    """Of several lists of starts those that a few full steps speak for, the most promising of each.

    The first-order test misjudges effects where its linearisation fails: it finds a negative gain, which a least-squares step can
    only cause there, or none at all.

    Where what was `refitted` leaves nothing but noise, what is as likely as the likeliest is at its top, and others have to come
    near it.
    """
    highest, rival = _highest(refitted), MUCH_WORSE
    done = [key for key, s in refitted.items() if s.log_likelihood > highest - CLOSE and times_its_innovations(s) < NOTHING_LEFT]
    if done:
        rival *= min(float(np.nanmean((_rms(refitted[key].residuals) / _rms(screen.base.residuals)) ** 2)) for key in done)

    def gain(start: PhysicalModel) -> float:
        there = screen.where(start)
        return glimpse(start, there.experiments, there.base, there.most_substeps, rival) - there.base.log_likelihood

    starts = [(which, start) for which, one in enumerate(doubted) for start in one if _key(start) not in done]
    gains = side_by_side(lambda each: gain(each[1]), starts)
    ranked = sorted((k for k in range(len(starts)) if gains[k] > 2.0), key=lambda k: -gains[k])
    return [starts[k][1] for n in range(len(doubted)) for k in [k for k in ranked if starts[k][0] == n][:SECOND_LOOKS]]


def _from_the_track(screen: Screen, pairs: Sequence[tuple[str, str]]) -> list[PhysicalModel]:
    """Starts of the effects that resemble what their balances lacked where the machine was, the most alike first."""
    found = [regressed for pair in pairs if (regressed := screen.regressed(*pair)) is not None]
    return [model for _, model in sorted(found, key=lambda one: -one[0])]


def _with_states(screen: Screen, pairs: Sequence[tuple[str, str]]) -> list[PhysicalModel]:
    """Starts of the effects with states of their own: no track shows those, and slow noise hides what they would explain."""
    own = [pair for pair in pairs if _has_states(screen.base.model, pair)]
    return [screened.start for pair in own for screened in screen.promising(*pair, most=2)]


def _has_states(model: PhysicalModel, key: tuple[str, str]) -> bool:
    """Whether an effect remembers: play, a second store, hysteresis."""
    effect = EFFECTS[key[0]]
    return bool(effect.states(model.site(key[1], effect)))


def within_a_sample(structure: Structure, key: tuple[str, str], experiments: Sequence[Experiment]) -> bool:
    """Whether an effect is a shift in time by less than a sample."""
    shift = structure.model.values.get(f"{structure.label_of(key)}.{SHIFTS.get(key[0], '')}", np.inf)
    return bool(shift < max(e.sample_time for e in experiments))


def simulates_no_worse(structure: Structure, before: Structure, rise: float = WORTH_A_LOOK) -> bool:
    """Whether the simulation error fell too: noise that is nearly integrated can swallow any slow error."""
    return mean_ratio(structure.rmse, before.rmse) < rise


def times_its_innovations(structure: Structure) -> float:
    """How far a structure's simulation error stands above what its noise cannot predict of it, at the output where it is most."""
    return float(np.nanmax(times_each_its_innovations(structure)))


def times_each_its_innovations(structure: Structure) -> FloatArray:
    """The same of each output; NaN where it was never measured."""
    innovations = [np.nan if noise is None else np.sqrt(noise.innovation_variance) for noise in structure.noises]
    return _rms(structure.residuals) / np.array(innovations)


def _rms(residuals: Sequence[FloatArray]) -> FloatArray:
    """Root mean square of each output; NaN where it was never measured."""
    stacked = np.concatenate(residuals)
    known = np.isfinite(stacked).sum(axis=0)
    return np.sqrt(np.nansum(stacked**2, axis=0) / np.where(known > 0, known, np.nan))


def mean_ratio(after: FloatArray, before: FloatArray) -> float:
    """Geometric mean over the outputs of the ratio of their errors."""
    return float(np.exp(np.nanmean(np.log(after / before))))


def schwarz(structure: Structure, base: Structure) -> float:
    """Schwarz's criterion."""
    return structure.log_likelihood - structure.penalty(base)
