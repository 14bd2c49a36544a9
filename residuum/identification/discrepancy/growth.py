"""Growing a structure: effects join while the data want one more, and give way to others that do more together."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.drifting_load import bears_a_drifting_load
from residuum.identification.discrepancy.evidence import ALIKE, preferred, relative_evidence, tempered_gain
from residuum.identification.discrepancy.held_out import cross_checked
from residuum.identification.discrepancy.looks import Task
from residuum.identification.discrepancy.pair_screen import promising_pairs
from residuum.identification.discrepancy.score_test import Screen, Screened
from residuum.identification.discrepancy.side_by_side import side_by_side
from residuum.identification.discrepancy.structures import (
    Structure,
    in_likelier_order,
    refit,
    times_its_innovations,
)
from residuum.identification.discrepancy.trials import (
    ACCEPT,
    LOWER_TOP,
    SHIFTS,
    SLOW,
    followed,
    mean_ratio,
    polished,
    schwarz,
    simulates_no_worse,
    within_a_sample,
)
from residuum.identification.physics import Experiment

FloatArray = npt.NDArray[np.float64]

_READING = "output-quantisation"
RISE, FALL = 1.005, 0.99
"""Factors of the outputs' errors, in the mean of their logarithms: by which they may rise with the first effect, and to which
they have to fall with a later one or where they are slow; less is enough where the gain is plain.
"""
HIGHER = 2.0
"""Log-likelihood by which another top is higher."""
PLAIN_FALL, _OF_READING = 0.95, 3.0
"""Factor to which the error has to fall at least with an effect of the reading alone, or where the mean square error is less than
so many times what the steps of the reading hide."""
PLAINLY_LESS, PLAINLY_MORE = 0.7, 100.0
"""An effect that few moments speak for joins where it takes held-out errors to this share and gains so much log-likelihood."""
ACCEPT_MORE = 6.0
"""As `ACCEPT`, of a second and third effect, which must not make up for what the first does not follow exactly."""
EXCHANGES = 3
"""How often at most effects that were accepted one by one are exchanged for others that do more together."""


@dataclass(eq=False)
class Search:
    """The structures that were tried.

    Attributes
    ----------
    base : Structure
        The model as it is, re-estimated.
    best : Structure
        Base plus the accepted effects.
    screened : mapping
        First-order result of every candidate against the base.
    accepted : list
        The effects that joined, one a step.
    before, alternatives : lists
        For each accepted effect the structure of the others, and candidate → the refitted structure with that candidate added;
        then those of the step that found no more.
    refuted : list
        Effects that the likelihood wanted, but whose held-out error rose: the search ends there.
    held_out : mapping
        Effect → held-out RMS errors of the outputs (before, with it), for those that were accepted or refuted.
    timing : list
        Delays and lags shorter than a sample that the data want: how the record was taken, not physics. They are in `best`.
    plain : list
        Accepted effects that few moments speak for, by what they take away elsewhere: tempered evidence does not say it.
    """

    base: Structure
    best: Structure
    count: int
    screened: dict[tuple[str, str], Screened] = field(default_factory=dict)
    before: list[Structure] = field(default_factory=list)
    alternatives: list[dict[tuple[str, str], Structure]] = field(default_factory=list)
    accepted: list[tuple[str, str]] = field(default_factory=list)
    refuted: list[tuple[str, str]] = field(default_factory=list)
    held_out: dict[tuple[str, str], tuple[FloatArray, FloatArray]] = field(default_factory=dict)
    timing: list[tuple[str, str]] = field(default_factory=list)
    plain: list[tuple[str, str]] = field(default_factory=list)

    @property
    def drifting(self) -> bool:
        """Whether an unknown load or offset that drifts is taken to be there, whatever else is."""
        return self.base.drifting or bears_a_drifting_load(self.base)

    def values_of(self, key: tuple[str, str]) -> dict[str, float]:
        """Every parameter, by full name, where an accepted effect, or one that was tried instead, was estimated last."""
        tried = [alternatives[key] for alternatives in self.alternatives[: len(self.accepted)] if key in alternatives]
        return (tried[-1] if tried and key not in self.timing else self.best).model.values

    def alike(self, key: tuple[str, str]) -> list[tuple[str, str]]:
        """An accepted effect, and those that the experiments cannot tell from it, the likeliest first."""
        if key not in self.accepted:
            return [key]
        step = self.accepted.index(key)
        structures = self.alternatives[step]
        scores, _ = relative_evidence(structures, self.before[step])
        others = [k for k in structures if k != key and scores[key] - scores[k] < ALIKE and k not in self.accepted]
        return [key, *sorted(others, key=lambda k: -scores[k])]


def grow(found: Search, task: Task, late: Callable[[Search], bool] | None = None) -> None:
    """Add effects while the evidence wants one more; what the last step tried stands after those of the accepted ones.

    Where a shift in time was accepted it ends if that is too `late`: at the other input timing fewer effects may do.
    """
    del found.before[len(found.accepted) :], found.alternatives[len(found.accepted) :]
    while len(found.accepted) < task.most_effects:
        refitted, screen = _step(found, task)
        _leave_to_the_noise(refitted, found.best)
        key, wins = _winner(refitted, found.best, evidence_asked(found, ACCEPT_MORE if found.accepted else ACCEPT))
        if not wins and (plain := _rare_but_plain(found, refitted, task.experiments)):
            key, wins = plain, True
            found.plain.append(plain)
        if key is not None and wins and _is_timing(key, refitted, found.best, task.experiments):
            found.timing.append(key)
            found.best = refitted[key]
            found.base = found.base if found.accepted else found.best
            if late is not None and found.accepted and late(found):
                break
            continue
        if key is not None and wins and (higher := _climbed_without(refitted[key], key, found, task.experiments)):
            found.best = higher
            found.base = found.base if found.accepted else higher
            continue
        found.before.append(found.best)
        found.alternatives.append(refitted)
        if key is None or not wins:
            break
        if not holds_up(found, key, refitted[key], task.experiments):
            found.refuted.append(key)
            break
        refitted[key] = in_likelier_order(followed(screen, key, refitted[key]), key, task.experiments)
        found.best = refitted[key]
        found.accepted.append(key)
        if late is not None and key[0] in SHIFTS and late(found):
            break


def _climbed_without(
    structure: Structure, key: tuple[str, str], found: Search, experiments: Sequence[Experiment]
) -> Structure | None:
    """The structure without its new effect, climbed from where that led to, when it ends higher than where it was left.

    The likelihood of what sticks and slides has many tops; any effect may lead from a lower one to a higher, and would seem
    missing. The first effect is believed where it gains more than that; a later one may have found the place of those before.
    """
    before = found.best.log_likelihood
    if not found.accepted and structure.log_likelihood > before + LOWER_TOP:
        return None
    less = _without(structure, key, experiments)
    return less if less is not None and less.log_likelihood > before + HIGHER else None


def _leave_to_the_noise(refitted: dict[tuple[str, str], Structure], best: Structure) -> None:
    """Take out the quantisation that is likeliest of all and yet lowers no error plainly: noise that is larger than its steps
    carries the reading over them, and it is a part of that noise.
    """
    while (key := preferred(refitted, best)) is not None and key[0] == _READING:
        if simulates_no_worse(refitted[key], best, PLAIN_FALL):
            break
        del refitted[key]


def _winner(
    refitted: Mapping[tuple[str, str], Structure], before: Structure, asked: float
) -> tuple[tuple[str, str] | None, bool]:
    """The preferred candidate, and whether its evidence against adding nothing is enough.

    Where it is not, of those whose own is: of two that few moments tell apart the one with fewer parameters is preferred, and
    may be wanted by those few alone.
    """
    nothing = relative_evidence(refitted, before)[1]
    if -nothing >= asked:
        return preferred(refitted, before), True
    wanted = {key: s for key, s in refitted.items() if tempered_gain(s, before) - s.penalty(before) >= asked}
    key = preferred(wanted, before)
    return (preferred(refitted, before), False) if key is None else (key, True)


def _step(found: Search, task: Task) -> tuple[dict[tuple[str, str], Structure], Screen]:
    look = task.look(found.best)
    if not found.accepted:
        found.screened = {s.key: s for s in look.tested}
    return dict(look.refitted), look.screen


def _is_timing(
    winner: tuple[str, str], refitted: Mapping[tuple[str, str], Structure], before: Structure, experiments: Sequence[Experiment]
) -> bool:
    """Whether a shift in time by less than a sample wins, and no physics that would do the same lies close."""
    evidence, _ = relative_evidence(refitted, before)
    close = [winner, *(key for key, value in evidence.items() if value > -ALIKE)]
    return all(within_a_sample(refitted[key], key, experiments) for key in close)


def _rare_but_plain(
    found: Search, refitted: dict[tuple[str, str], Structure], experiments: Sequence[Experiment]
) -> tuple[str, str] | None:
    """The likeliest effect where few moments speak for it (a stop, a limit), but most of the error goes with it on data not used,
    once it is climbed to its top.

    Tempering makes each moment worth two units, whatever it shows; an error that vanishes elsewhere too is no lucky moment.
    """
    inside = {key: s for key, s in refitted.items() if preferred({key: s}, found.best) is not None}
    key = max(inside, key=lambda each: schwarz(inside[each], found.best), default=None)
    if key is None or schwarz(inside[key], found.best) - found.best.log_likelihood < evidence_asked(found, PLAINLY_MORE):
        return None
    refitted[key] = polished(refitted[key], experiments)
    errors = _held_out_errors(found.best, refitted[key], experiments)
    return key if errors is not None and mean_ratio(errors[1], errors[0]) < PLAINLY_LESS else None


def settle(found: Search, task: Task) -> None:
    """Exchange what was accepted one by one for what does more together, until nothing changes."""
    exchange_all(found, task, [] if _two_instead(found, task) else found.accepted[-1:])


def exchange_all(found: Search, task: Task, settled: list[tuple[str, str]]) -> None:
    """Judge all that was accepted but what is `settled` again, and add what is wanted then, until nothing changes."""
    for _ in range(EXCHANGES):
        if not _exchange(found, task, settled):
            break
        grow(found, task)
        settled = found.accepted[-1:]


def _exchange(found: Search, task: Task, settled: list[tuple[str, str]]) -> bool:
    """Judge each of several effects again on top of the others: kept, exchanged for a better one, or dropped as needless.

    The first that a greedy search accepts may only stand for two that are missing together (viscous friction for drag and rolling
    friction), which later steps bring to light; or it was started where it made up for them (a spring at rest elsewhere), and
    does better from another start now. Those `settled` were judged on top of the others already.

    True when an effect was exchanged, dropped or put elsewhere.
    """
    exchanges = 0
    while exchanges < EXCHANGES and (waiting := [key for key in found.accepted if key not in settled]):
        key, at = waiting[0], found.accepted.index(waiting[0])
        others = _without(found.best, key, task.experiments)
        if others is None:
            settled.append(key)
            continue
        look = task.look(others, key)
        look.add({key: followed(look.screen, key, found.best)}, (), [key])
        refitted = {k: s for k, s in look.refitted.items() if k == key or not within_a_sample(s, k, task.experiments)}
        best, wins = _winner(refitted, others, evidence_asked(found, ACCEPT_MORE))
        if best == key and wins:
            moved = _moved(refitted[key], found.best)
            settled, exchanges = [key] if moved else [*settled, key], exchanges + moved
            found.best, found.before[at], found.alternatives[at] = refitted[key], others, refitted
            continue
        exchanges += 1
        found.best, settled = others, []
        for steps in (found.accepted, found.before, found.alternatives):
            del steps[at]
        if best is not None and wins:
            found.best = refitted[best] = polished(refitted[best], task.experiments)
            found.before.insert(len(found.accepted), others)
            found.alternatives.insert(len(found.accepted), refitted)
            found.accepted.append(best)
            settled = [best]
    return exchanges > 0


def _moved(structure: Structure, before: Structure) -> bool:
    """Whether what effects hold fixed was put elsewhere."""
    known = before.model.all_parameters
    return any(known[n].fixed and value != known[n].value for n, value in structure.model.values.items() if n in known)


def _without(structure: Structure, key: tuple[str, str], experiments: Sequence[Experiment]) -> Structure | None:
    """The structure re-estimated without one of its effects, whose part one that generalises it takes; None when it diverges."""
    label, values = structure.label_of(key), structure.model.values
    others = [use for use in structure.model.effects if use.target == key[1] and use.label != label]
    heirs = [use for use in others if use.effect.generalises == key[0]]
    parts = {f"{use.label}.{n}": values[f"{label}.{n}"] for use in heirs for n in use.effect.sizes if f"{label}.{n}" in values}
    less = structure.model.without_effect(label).with_values({n: values[n] + part for n, part in parts.items()})
    return refit(structure, less, experiments)


def _two_instead(found: Search, task: Task) -> bool:
    """Put two effects in place of those accepted where they do more together; whether that was so."""
    if not found.accepted:
        return False
    base = found.base
    pairs = promising_pairs(base, found.best, found.accepted, found.screened)
    fitted = [refit(found.best, m, task.experiments) for m in pairs]
    asked = evidence_asked(found, ACCEPT_MORE) if len(found.accepted) == 1 else 0.0
    better = [s for s in fitted if s is not None and tempered_gain(s, found.best) - s.penalty(found.best) > asked]
    if not better:
        return False
    pair = polished(max(better, key=lambda s: schwarz(s, base)), task.experiments)
    other = with_two(found, pair, task.experiments)
    if other is None:
        return False
    found.accepted, found.best, found.before, found.alternatives = other.accepted, other.best, other.before, other.alternatives
    return True


def with_two(found: Search, pair: Structure, experiments: Sequence[Experiment]) -> Search | None:
    """The search with the last two effects of a structure accepted in place of what it had; None where they do not hold up."""
    first, second = ((use.id, use.target) for use in pair.model.effects[-2:])
    if not holds_up(found, second, pair, experiments):
        return None
    accepted, alternatives = [first, second], [{first: pair}, {second: pair}]
    return replace(found, accepted=accepted, best=pair, before=[found.base, found.base], alternatives=alternatives)


def evidence_asked(found: Search, beyond: float) -> float:
    """Evidence that an effect needs: so much beyond the logarithm of how many there are to choose from."""
    return float(np.log(max(found.count, 1))) + beyond


def holds_up(found: Search, key: tuple[str, str], better: Structure, experiments: Sequence[Experiment]) -> bool:
    """Whether the effect raises neither the simulation error nor that on data which were not used for the estimation.

    An unmeasured disturbance can let the likelihood win by the fast part of the error alone, while what the user sees grows.
    Where the end of the record shows what the rest never did (a tank that runs over), its beginning has a say.
    """
    plain = tempered_gain(better, found.best) > PLAINLY_MORE
    doubted = 1.0 if plain else FALL
    if not simulates_no_worse(better, found.best, doubted if found.accepted or times_its_innovations(better) > SLOW else RISE):
        return False
    if _is_the_readings(found.best, better):
        return False
    errors = _held_out_errors(found.best, better, experiments)
    if errors is None:
        return True
    found.held_out[key] = errors
    ratio = mean_ratio(errors[1], errors[0])
    if ratio < (doubted if found.accepted else RISE):
        return True
    other = _held_out_errors(found.best, better, experiments, end=False)
    if other is None or np.sqrt(ratio * mean_ratio(other[1], other[0])) > PLAINLY_LESS:
        return False
    found.held_out[key] = other
    return True


def _held_out_errors(
    before: Structure, after: Structure, experiments: Sequence[Experiment], *, end: bool = True
) -> tuple[FloatArray, FloatArray] | None:
    """`cross_checked` errors of two structures; None where one has none."""
    errors = side_by_side(lambda structure: cross_checked(structure, experiments, end=end), (before, after))
    return None if errors[0] is None or errors[1] is None else (errors[0], errors[1])


def _is_the_readings(before: Structure, better: Structure) -> bool:
    """Whether what falls is the error of outputs that are read coarsely, and falls little.

    A machine that stands, or turns at few speeds, errs there by up to half a step, always the same: any effect may take that up.
    """
    read = before.rmse**2 < _OF_READING * before.reading
    ratio = better.rmse / before.rmse
    return bool(read.any() and not np.any(ratio < np.where(read, PLAIN_FALL, FALL)))
