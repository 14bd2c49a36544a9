"""What a search on blocks may propose, what it has tried so far, in which unit of the error, and at
which input timing.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from operator import itemgetter
from typing import TYPE_CHECKING

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.errors import MAY_DIVERGE, NotIdentifiable
from residuum.identification.physics import Key, Simulator
from residuum.identification.residual_analysis.noise import times_the_noise
from residuum.identification.side_by_side import each_beside
from residuum.identification.unseen_blocks.comparing import is_alike, is_real
from residuum.identification.unseen_blocks.cross_validation import (
    CrossValidation,
    ValidatedFit,
    validated,
)
from residuum.identification.unseen_blocks.data import Data, Horizon, one_turned, turned
from residuum.identification.unseen_blocks.policy import (
    KEPT,
    NOISY,
    ONE_PHYSICS,
    SAME_NOISE,
    UNEVEN,
)
from residuum.identification.unseen_blocks.proposals import special_of
from residuum.identification.unseen_blocks.scale import Scale, clipped, of_noise, of_power
from residuum.identification.unseen_blocks.structure import (
    Structure,
    descended,
    first_states,
    innovations_on,
    too_few,
)

if TYPE_CHECKING:
    from residuum.identification.unseen_blocks.following import Track
    from residuum.identification.unseen_blocks.multiple_shooting import FirstFit


@dataclass(frozen=True)
class Wanted:
    """What may be proposed: the effects of these ids (None: all), learned curves, values that the
    model holds.
    """

    effects: tuple[str, ...] | None = None
    learned: bool = False
    held: bool = True


@dataclass(eq=False)
class Search:
    """What was tried.

    `base` is the model as it is, `best` with what joined, both judged by `validation`; `every`
    structure that was judged there by its keys; `group` those that cannot be told from the best;
    `tried` how many proposals the last level had; `proposed` what was fitted quickly.
    """

    validation: CrossValidation
    base: ValidatedFit
    best: ValidatedFit
    along: Track | None
    every: dict[tuple[Key, ...], ValidatedFit] = field(default_factory=dict)
    group: list[ValidatedFit] = field(default_factory=list)
    tried: int = 1
    proposed: set[Key] = field(default_factory=set)


def with_only(
    search: Search, keys: Iterable[Key], whole: ValidatedFit | None = None
) -> ValidatedFit | None:
    """A structure, by default the best one, with these of its effects alone; None where that
    diverges.
    """
    retained, whole = tuple(sorted(keys)), whole or search.best
    if retained in search.every:
        return search.every[retained]
    model = whole.model
    for use in whole.model.effects:
        # an effect of the model as it was given is none of the structure's, and stays
        if use.key in whole.keys and use.key not in retained:
            model = model.without_effect(use.label)
    structure = Structure(retained, model, whole.structure.states, whole.structure.steps)
    fit = search.validation.validate(structure, steps=15, tolerance=1e-5)
    if fit is not None:
        search.every[retained] = fit
    return fit


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
            best, less, outcome.base, outcome.validation.scale, outcome.tried
        ):
            outcome.best, outcome.group = less, []


def _without(outcome: Search, key: Key) -> ValidatedFit | None:
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


# The best structure taken apart: in which order its effects take away what, and what does the
# same in the place of each.


def chain(search: Search, keys: Iterable[Key]) -> list[tuple[Key, ValidatedFit, ValidatedFit]]:
    """The effects `keys` of the best structure in the order in which each takes away most, with
    what was before and after it.
    """
    remaining, before, order = list(keys), search.base, []
    # forward selection once more among those that joined: in the search each was chosen beside
    # other ones, and what joined first may be worth little beside what joined later
    while remaining:
        trials = [(key, with_only(search, (*before.keys, key))) for key in remaining]
        known = [(key, trial) for key, trial in trials if trial is not None]
        if not known:
            break
        key, after = min(known, key=lambda known_trial: known_trial[1].cost)
        order.append((key, before, after))
        remaining.remove(key)
        before = after
    return order


def in_place_of(search: Search, key: Key, context: Sequence[Key]) -> list[ValidatedFit]:
    """What does the same in the place of one of the best structure's effects, the others kept; each
    as it is beside the others.
    """
    best, retained, scale = search.best, set(search.best.keys) - {key}, search.validation.scale
    without = search.every.get(tuple(sorted(retained)))
    rivals = [
        rival
        for rival in search.every.values()
        if rival.keys != best.keys
        and len(rival.keys) == len(best.keys)
        and set(rival.keys) > retained
    ]
    same = []
    for rival in rivals:
        stand_in = next(iter(set(rival.keys) - retained))
        alike = is_alike(rival, best, without, scale)
        # in power alone: in nats each parameter of the general one has its price
        if not alike and not scale.nats:
            alike = _are_one_physics(rival, best, without, (stand_in, key))
        if alike:
            same.append(with_only(search, (*context, stand_in), rival))
    return [rival for rival in same if rival is not None]


def _are_one_physics(
    rival: ValidatedFit, best: ValidatedFit, without: ValidatedFit | None, keys: tuple[Key, Key]
) -> bool:
    """Whether of two effects one generalises the other, and the one in the other's place takes away
    nearly as much.
    """
    related = special_of(keys[0]) == keys[1] or special_of(keys[1]) == keys[0]
    return (
        related
        and without is not None
        and without.cost - rival.cost > ONE_PHYSICS * (without.cost - best.cost)
    )


# The unit of the error: nats of noise, once what a structure leaves is noise alike all along the
# records.


def validated_in_nats(
    best: ValidatedFit, validation: CrossValidation
) -> tuple[CrossValidation, ValidatedFit] | None:
    """The validation in nats and the structure judged there, where what it leaves is noise alike
    all along the records; None otherwise.
    """
    last, data = validation.last, validation.data
    fit = validation.begun(best.structure)
    if fit is None:
        return None
    # weights and filters are those of what is left, and what is left depends on them: iterated
    scale = replace(of_noise(fit.residuals, last, data.measured), filters=None)
    for _ in range(3):  # outputs weighed by their own errors, then these whitened
        fit = descended(fit.in_unit(scale), steps=12, tolerance=1e-5)
        if fit.cost == np.inf:
            return None
        scale = of_noise(fit.residuals, last, data.measured)
    times = max(
        times_the_noise([r[:, o] for r in fit.residuals]) for o in np.flatnonzero(data.measured)
    )
    # noise of some colour, and alike all along: an inexact machine's error may look like the first,
    # but it is larger where the machine does what the model does not know
    if times > NOISY or _unevenness(fit.residuals, scale, validation) > UNEVEN:
        return None
    scale = clipped(scale, fit.residuals, last)
    fit = fit.in_unit(scale)
    in_nats = validated(best.structure.at(last, fit), fit, last, data, scale)
    return None if in_nats is None else (replace(validation, scale=scale), in_nats)


def settle(outcome: Search) -> None:
    """What was found in nats, in the noise that it leaves itself, and with as many integration steps
    a sample as its simulation asks for.
    """
    in_its_own_noise(outcome, ())
    outcome.best = outcome.every[outcome.best.keys] = _accurate(outcome.best, outcome.validation)


def in_its_own_noise(outcome: Search, ranked: Sequence[ValidatedFit]) -> list[ValidatedFit]:
    """Those `ranked`, the best first. In nats they, the best structure and those that come nearest to
    it are judged in the noise that it leaves, where that is another than the noise before: in noise
    of the colour of what was missing, values err by more than their bands, and the input timing
    by half a sample.
    """
    if outcome.validation.scale.nats:
        _rejudge(outcome)
    known = (outcome.every.get(fit.keys) for fit in ranked)
    return sorted((fit for fit in known if fit is not None), key=lambda fit: fit.cost)


def _rejudge(outcome: Search) -> None:
    rejudged = validated_in_nats(outcome.best, outcome.validation)
    if rejudged is None or rejudged[0].scale.is_like(outcome.validation.scale, SAME_NOISE):
        return
    validation, best = rejudged
    by_cost = sorted(outcome.every.values(), key=lambda fit: fit.cost)
    rivals = [fit for fit in by_cost if fit.keys not in ((), best.keys)][:KEPT]
    structures = [outcome.base.structure, *(rival.structure for rival in rivals)]
    base, *others = each_beside(partial(validation.validate, steps=15, tolerance=1e-6), structures)
    if base is None:
        return
    known = {fit.keys: fit for fit in others if fit is not None}
    outcome.validation, outcome.best, outcome.base = validation, best, base
    outcome.every = {(): base, best.keys: best} | known
    outcome.group = [known[fit.keys] for fit in outcome.group if fit.keys in known]


def _accurate(best: ValidatedFit, validation: CrossValidation) -> ValidatedFit:
    """The structure refitted with as many integration steps a sample as its simulation asks for; as
    it was, where that leaves more.

    Steps that follow the modes do for a search. In noise alone values are as sure as a fraction of
    the error of such a step: a shift in time by parts of a sample bends the input within it.
    """
    last, structure = validation.last, best.structure
    simulator, taken = Simulator(best.model), structure.steps[last.windows]
    X0 = first_states(simulator, last, structure.states[last.windows])
    steps = np.maximum(simulator.substeps_each(last.parts, X0, simulator.p()), taken).tolist()
    if steps == list(taken):
        return best
    finer = structure.with_steps(last.windows, steps)
    refitted = validation.validate(finer, steps=15, tolerance=1e-6)
    return best if refitted is None or refitted.cost > best.cost else refitted


def resolved(
    found: ValidatedFit, before: ValidatedFit, validation: CrossValidation
) -> ValidatedFit | None:
    """The structure refitted with the integration steps that its own modes ask for, where what it
    has beyond the one before makes them faster than its steps follow; itself where it does not.
    None where it diverges with them.

    A lag at the limit of the integrator's stability has any time constant but its own, and passes
    for physics.
    """
    windows = validation.last.windows
    taken = found.structure.steps[windows]
    needed = _modal_steps(found, validation.last)
    if not too_few(taken, needed):
        return found
    # a machine that is stiffer than any search follows stays as it was followed
    if not too_few(np.maximum(taken, _modal_steps(before, validation.last)).tolist(), needed):
        return found
    finer = found.structure.with_steps(windows, np.maximum(needed, taken).tolist())
    return validation.validate(finer, steps=15, tolerance=1e-5)


def exchange(
    outcome: Search, ranked: list[ValidatedFit], found: ValidatedFit, other: ValidatedFit | None
) -> None:
    """Another fit of the same structure in the place of one, among those `ranked` and all that were
    tried; nothing in its place where there is none.
    """
    ranked.remove(found)
    if other is not None:
        outcome.every[other.keys] = other
        ranked.append(other)
        ranked.sort(key=lambda rival: rival.cost)


def _modal_steps(found: ValidatedFit, last: Horizon) -> list[int]:
    """Steps a sample that the fastest mode of each window asks for."""
    simulator = Simulator(found.model)
    X0 = first_states(simulator, last, found.structure.states[last.windows])
    return simulator.modal_substeps(last.parts, X0, simulator.p())


def _unevenness(
    residuals: Sequence[FloatArray], scale: Scale, validation: CrossValidation
) -> float:
    """Times the scatter of white noise that the powers of the blocks have, at the output where it
    is most.
    """
    starts, measured = validation.last.starts.tolist(), validation.data.measured
    white = scale.whitened(np.nan_to_num(np.concatenate(residuals)) * scale.weights, starts)[
        :, measured
    ]
    block = validation.last.block
    n = np.bincount(block, minlength=validation.data.blocks)
    powers = [
        np.bincount(block, weights=column**2, minlength=len(n))[n > 0] / n[n > 0]
        for column in white.T
    ]
    # the mean of n squares of white noise scatters by √(2/n) of itself, so does its logarithm
    scatter = np.sqrt(2.0 / n[n > 0].mean())
    return max(float(np.std(np.log(np.maximum(p, 1e-300)), ddof=1) / scatter) for p in powers)


# Where a search begins: the model as it is, judged.


def begun(start: FirstFit) -> Search:
    """The model as it is, judged; in nats where all it leaves is noise."""
    data, last = start.data, start.last
    first = validated(start.structure, start.found, last, data, start.scale)
    if first is None:
        raise NotIdentifiable(f"model {data.model.name!r}: diverges on the records; {MAY_DIVERGE}")
    scale = of_power(start.scale, data, first.power)
    # infinite: whatever is tried beside the model as it is counts as fitting the seen blocks better
    first = replace(first, cost=scale.cost(first.power, first.parameters), seen_cost=np.inf)
    validation = CrossValidation(data, last, start.middle, scale, start.window_errors)
    in_noise = validated_in_nats(first, validation)
    if in_noise is not None:
        validation, first = in_noise
    return Search(validation, first, first, None, {(): first})


# The input timing that suits what was found: the timing of the data was chosen before anything
# was.


def at_the_timing_it_suits(search: Search) -> Data | None:
    """The data at the other input timing, where the best structure fits better there; None where it
    does not, or nothing drives the machine.
    """
    validation = search.validation
    if not search.best.model.inputs:
        return None
    current = _innovations(search, validation.data)
    alternatives = [
        (_innovations(search, data), data)
        for data in (turned(validation.data), *one_turned(validation.data))
    ]
    least, likeliest = min(alternatives, key=itemgetter(0))
    return likeliest if least < current else None


def _innovations(search: Search, data: Data) -> float:
    validation = search.validation
    horizon = validation.last if data is validation.data else data.horizon(validation.last.windows)
    return innovations_on(horizon, search.best.model, search.best.structure, validation.scale)
