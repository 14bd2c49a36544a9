"""From what was tried to names: groups, probabilities that were counted, and the verdict.

Blocks are drawn again with replacement; in every draw the structure wins that would have been
chosen on those blocks. What a group, "none" and "unknown" win is their probability. A name that
took a part, or that acts when nobody recorded, shares what it wins with "unknown": no draw of
blocks shows what else would have done the same.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.physics import Key, PhysicalModel, noise_floor
from residuum.identification.physics.model import find_effect
from residuum.identification.unseen_blocks.comparing import OnBlocks, evidence, is_alike, share
from residuum.identification.unseen_blocks.policy import (
    DOUBTED,
    DRAWS,
    LISTED,
    MOST_RIVALS,
    PLAINLY_A_PART,
    SMALL,
    TIE,
    UNKNOWN_LEADS,
    WORTH,
)
from residuum.identification.unseen_blocks.structure import HELD
from residuum.identification.unseen_blocks.tried import Search, chain, in_place_of

if TYPE_CHECKING:
    from residuum.identification.physics.effects.base import Parameter
    from residuum.identification.unseen_blocks.cross_validation import CrossValidation, ValidatedFit
    from residuum.identification.unseen_blocks.free_term import BlockTerm
    from residuum.identification.unseen_blocks.scale import Scale

# One effect that may be missing, and what is said of it.


@dataclass(frozen=True)
class Quantity:
    """A number with its standard deviation and unit."""

    value: float
    std: float
    unit: str


@dataclass(frozen=True)
class Candidate:
    """One effect that may be missing, with what speaks for it.

    `step` counts the effects that were accepted before it; `evidence` is its log odds against
    "nothing more is missing"; the errors are RMS simulation errors of `output` before and after it
    was added, on data that were not used for the estimation where `held_out` says so; `share` is
    the part of the error's power that it takes away on blocks kept aside; `alike` are the effects
    that cannot be told from it.
    """

    effect: str
    balance: str
    probability: float
    alike: tuple[Key, ...]
    parameters: Mapping[str, Quantity]
    error_before: float
    error_after: float
    error_unit: str
    output: str
    within_bounds: bool
    evidence: float
    step: int = 0
    held_out: bool = False
    share: Quantity | None = None

    @property
    def key(self) -> Key:
        """The effect at its place."""
        return Key(self.effect, self.balance)

    @property
    def indistinguishable_from(self) -> tuple[str, ...]:
        """The effects that cannot be told from it, each once however many its places."""
        return tuple(dict.fromkeys(key.effect for key in self.alike))

    @property
    def rivals(self) -> tuple[str, ...]:
        """What cannot be told from it, for people: with its place where the effect has several."""
        effects = [self.effect, *(key.effect for key in self.alike)]
        return tuple(
            f"{key.effect}@{key.target}" if effects.count(key.effect) > 1 else key.effect
            for key in self.alike
        )


NONE, UNKNOWN = "none", "unknown"


@dataclass(frozen=True)
class Step:
    """An effect that joined: the structures before and after, those that do the same in its place,
    and what else was tried there.
    """

    key: Key
    before: ValidatedFit
    after: ValidatedFit
    group: tuple[ValidatedFit, ...]
    unlike: tuple[ValidatedFit, ...]


@dataclass(frozen=True)
class Verdict:
    """What is said: probabilities of nothing and of something without a name, and the candidates,
    the accepted ones first.
    """

    verdict: str
    candidates: tuple[Candidate, ...]
    none: float
    unknown: float


def steps_of(search: Search) -> list[Step]:
    """The effects that joined, in the order in which each takes away most."""
    return [_step(search, *joined) for joined in chain(search, search.best.keys)]


def _step(search: Search, key: Key, before: ValidatedFit, after: ValidatedFit) -> Step:
    """An effect that joined, with what does the same in its place and what else was tried there."""
    earlier = set(before.keys)
    rivals = [
        rival
        for rival in search.every.values()
        if set(rival.keys) > earlier
        and len(rival.keys) == len(after.keys)
        and rival.keys != after.keys
    ]
    rivals.sort(key=lambda rival: rival.cost)
    alike = [rival for rival in rivals if is_alike(rival, after, before, search.validation.scale)]
    # the last effect's group is known from the search, where all were judged beside it
    if after.keys == search.best.keys:
        alike += _new(alike, [rival for rival in search.group if set(rival.keys) > earlier])
    alike += _new(alike, in_place_of(search, key, before.keys))
    # What does not lower the error beyond its price has no probability to share, however near
    # it lies.
    alike = [rival for rival in alike if rival.cost < before.cost]
    unlike = tuple(rival for rival in rivals if rival not in alike)
    return Step(key, before, after, tuple(alike), unlike)


def _new(known: Sequence[ValidatedFit], more: Sequence[ValidatedFit]) -> list[ValidatedFit]:
    """Of more structures those whose effects are none of the known ones'."""
    keys = {validated.keys for validated in known}
    return [validated for validated in more if validated.keys not in keys]


def counted(
    search: Search, free: Sequence[BlockTerm], *, adequate: bool
) -> dict[tuple[Key, ...] | str, float]:
    """How often each structure wins when blocks are drawn again. Where none is worth its place,
    "none" wins if the model is `adequate`, else "unknown". "unknown" wins also where a free term
    does plainly more of what is structured. What fits all blocks no better than the model as it is
    wins nowhere: where one block tells a value alone, deletion is ahead in every draw that has that
    block.
    """
    scale, base = search.validation.scale, search.base
    tried = _entrants(search)
    terms: Sequence[BlockTerm] = [] if adequate else free
    entrants: list[OnBlocks] = [*tried, *terms]
    names: list[tuple[Key, ...] | str] = [rival.keys for rival in tried] + [UNKNOWN] * len(terms)
    sizes = np.array([entrant.parameters for entrant in entrants])
    by_block = np.array([scale.by_block(entrant.power) for entrant in entrants])
    # bootstrap over blocks: the same draws for all, so that they are compared in pairs
    pick = np.random.default_rng(0).integers(0, by_block.shape[1], (DRAWS, by_block.shape[1]))
    price = scale.price if scale.nats else 0.0
    costs = by_block[:, pick].sum(axis=2) + price * sizes[:, None]
    nothing = scale.by_block(base.power)[pick].sum(axis=1) + price * base.parameters
    winner = _simplest_near_the_best(costs, sizes, scale)
    gain = nothing - costs[winner, np.arange(DRAWS)]
    worth = gain > _least_gain(nothing, search)
    # what is left where no name is worth its place, or the model as it is, without any, wins
    unnamed = NONE if adequate else UNKNOWN
    wins: dict[tuple[Key, ...] | str, float] = {}
    for k, is_worth in zip(winner.tolist(), worth, strict=True):
        name = (names[k] if is_worth else ()) or unnamed
        wins[name] = wins.get(name, 0.0) + 1.0 / DRAWS
    return wins


def _entrants(search: Search) -> list[ValidatedFit]:
    """The model as it is and the best of the structures that fit the blocks which they have seen
    better than it does.
    """
    base = search.base
    fitting = [
        rival
        for rival in search.every.values()
        if not rival.keys or rival.seen_cost < base.seen_cost
    ]
    return sorted(fitting, key=lambda rival: rival.cost)[:MOST_RIVALS]


def _least_gain(nothing: FloatArray, search: Search) -> FloatArray | float:
    """What a winner has to take away of the cost of the model as it is in each draw, `nothing`
    (draws,), as when an effect joins.
    """
    scale = search.validation.scale
    if scale.nats:
        return float(np.log(max(search.tried, 1)) + TIE)
    return np.maximum(WORTH * (nothing - scale.floor), SMALL)


def _simplest_near_the_best(
    costs: FloatArray, sizes: FloatArray, scale: Scale
) -> npt.NDArray[np.intp]:
    """Of each draw the one with the fewest parameters among those near the lowest of the costs
    (entrants, draws), as a search chooses; of equally many parameters the lower cost.
    """
    lead = costs.min(axis=0)
    near = costs < (lead + TIE if scale.nats else 1.1 * lead)
    # the relative cost counts for so little that it decides between equal sizes alone
    rank = sizes[:, None] + 1e-9 * costs / np.maximum(lead, 1e-300)
    return np.argmin(np.where(near, rank, np.inf), axis=0)


def verdict_on(
    search: Search,
    joined: Sequence[Step],
    free: Sequence[BlockTerm],
    stds: Mapping[str, float],
    *,
    adequate: bool,
) -> Verdict:
    """The verdict on the steps that `joined`; `adequate`: whether nothing is structured in what the
    best structure leaves.
    """
    nothing = NONE if adequate else UNKNOWN
    timing = _timing(search, joined)
    wins = _named(counted(search, free, adequate=adequate), timing, nothing)
    steps = [step for step in joined if step.key not in timing]
    if steps and _is_doubtful(steps, search, adequate=adequate):
        wins = _doubted(wins)
    listed = _listed(steps, wins, stds, search) if steps else _undecided(search, wins, stds, timing)
    unknown, none = wins.get(UNKNOWN, 0.0), wins.get(NONE, 0.0)
    # one draw counts for several where a structure of two effects wins it: probabilities of the
    # first step, "none" and "unknown" share one
    named = sum(candidate.probability for candidate in listed if candidate.step == 0)
    excess = max(named + none + unknown, 1.0)
    listed = [replace(entry, probability=entry.probability * (1.0 / excess)) for entry in listed]
    remainder = max(0.0, 1.0 - named / excess - none / excess)
    says = _without_doubt(steps, listed, adequate=adequate)
    if steps and unknown >= UNKNOWN_LEADS:
        says = "unknown-effect"
    return Verdict(says, tuple(listed), none / excess, remainder)


def _without_doubt(steps: Sequence[Step], listed: Sequence[Candidate], *, adequate: bool) -> str:
    """The verdict where nothing without a name leads."""
    has_effect = any(step.key.effect != HELD for step in steps)
    if has_effect and any(candidate.probability > 0.0 for candidate in listed):
        return "missing-effect"
    return "adequate" if adequate else "unknown-effect"


def _timing(search: Search, joined: Sequence[Step]) -> set[Key]:
    """The effects that shift time by less than a sample: of those that joined, or, where none did,
    of those that were tried alone, for such a shift is no physics either.
    """
    if joined:
        return {step.key for step in joined if is_timing(step.key, search)}
    alone = [fit for fit in search.every.values() if len(fit.keys) == 1]
    return {fit.keys[0] for fit in alone if is_timing(fit.keys[0], search, fit.model)}


def _listed(
    steps: Sequence[Step],
    wins: Mapping[tuple[Key, ...] | str, float],
    stds: Mapping[str, float],
    search: Search,
) -> list[Candidate]:
    """The candidates of every step that is an effect; held values are told beside them."""
    effects = [step for step in steps if step.key.effect != HELD]
    return [
        candidate
        for number, step in enumerate(effects)
        for candidate in _candidates(step, number, wins, stds, search)
    ]


def _named(
    wins: Mapping[tuple[Key, ...] | str, float], timing: set[Key], nothing: str
) -> dict[tuple[Key, ...] | str, float]:
    """What was counted, told as `nothing` where no physics is named: a structure of how the record
    was taken and of values that the model holds has none.
    """
    named: dict[tuple[Key, ...] | str, float] = {}
    for keys, won in wins.items():
        physics = isinstance(keys, str) or any(
            key.effect != HELD and key not in timing for key in keys
        )
        name = keys if physics else nothing
        named[name] = named.get(name, 0.0) + won
    return named


def _is_doubtful(steps: Sequence[Step], search: Search, *, adequate: bool) -> bool:
    """Whether something without a name may stand behind the effects that joined: where they took a
    part of what is structured, or where no record says when one acts, for a load that came and went
    once may have been anything.
    """
    recorded = all(step.key.effect == HELD or step.after.model.records(step.key) for step in steps)
    return not recorded or (not adequate and _took_a_part(search))


def _took_a_part(search: Search) -> bool:
    """Whether plainly more than noise is left of the error: the nearest shape in the catalogue to
    something else does that.
    """
    scale, base = search.validation.scale, search.base
    return not scale.nats and base.cost - search.best.cost < PLAINLY_A_PART * (
        base.cost - scale.floor
    )


def _doubted(wins: Mapping[tuple[Key, ...] | str, float]) -> dict[tuple[Key, ...] | str, float]:
    """What was counted, where a name that wins may stand for something that has none."""
    named = sum(won for keys, won in wins.items() if not isinstance(keys, str))
    less = {
        keys: won if isinstance(keys, str) else (1.0 - DOUBTED) * won for keys, won in wins.items()
    }
    return {**less, UNKNOWN: less.get(UNKNOWN, 0.0) + DOUBTED * named}


def is_timing(key: Key, search: Search, model: PhysicalModel | None = None) -> bool:
    """Whether an effect of the best model, or of this one, shifts time by less than a sample: how
    the record was taken, not physics.
    """
    shift = "" if key.effect == HELD else find_effect(key.effect).shifts
    if not shift:
        return False
    use = next(use for use in (model or search.best.model).effects if use.key == key)
    return abs(use.parameters[shift].value) < max(
        e.sample_time for e in search.validation.data.experiments
    )


def _candidates(
    step: Step,
    number: int,
    wins: Mapping[tuple[Key, ...] | str, float],
    stds: Mapping[str, float],
    search: Search,
) -> list[Candidate]:
    """The accepted effect, its group, and what else won draws in its place; a group shares what it
    wins.

    A structure that holds one of the group and another effect won for the group: the other one has
    no part in it.
    """
    earlier = set(step.before.keys)
    group = {step.key: step.after} | _by_added(step.group, earlier)
    named = [key for key in group if key.effect != HELD]
    won = [(set(keys), share) for keys, share in wins.items() if not isinstance(keys, str)]
    together = sum(share for keys, share in won if keys & group.keys())
    entries = [
        _Entry(key, group[key], together / len(named), [k for k in named if k != key])
        for key in named
    ]
    if number == 0:  # rivals are told of the first step alone
        elsewhere = [(keys, share) for keys, share in won if not keys & group.keys()]
        entries += _rivals(step, elsewhere)
    return [_candidate(entry, step.before, number, stds, search) for entry in entries]


def _rivals(step: Step, won: Sequence[tuple[set[Key], float]]) -> list[_Entry]:
    """What else was tried at a step, the most probable first, with the draws that it `won`."""
    earlier = set(step.before.keys)
    rivals = _by_added(step.unlike, earlier)
    shares = {key: sum(share for keys, share in won if key in keys) for key in rivals}
    effects = [key for key in rivals if key.effect != HELD]
    leading = sorted(effects, key=lambda key: (-shares[key], rivals[key].cost))[:LISTED]
    return [_Entry(key, rivals[key], 0.0 if earlier else shares[key]) for key in leading]


def _by_added(structures: Sequence[ValidatedFit], earlier: set[Key]) -> dict[Key, ValidatedFit]:
    """Structures with one effect more than the earlier ones, by that effect."""
    by_added = {}
    for validated in structures:
        added = set(validated.keys) - earlier
        if len(added) == 1:
            by_added[added.pop()] = validated
    return by_added


def _undecided(
    search: Search,
    wins: Mapping[tuple[Key, ...] | str, float],
    stds: Mapping[str, float],
    timing: set[Key],
) -> list[Candidate]:
    """Nothing is real: those that took away most are told with what they win."""
    alone = [fit for fit in search.every.values() if len(fit.keys) == 1]
    base = search.base
    listed = [
        fit
        for fit in sorted(alone, key=lambda fit: fit.cost)[:LISTED]
        if fit.keys[0].effect != HELD and fit.keys[0] not in timing and fit.cost < base.cost
    ]
    return [
        _candidate(_Entry(fit.keys[0], fit, wins.get(fit.keys, 0.0)), base, 0, stds, search)
        for fit in listed
    ]


@dataclass(frozen=True)
class _Entry:
    """An effect of a structure, the probability that it is told with, and which others cannot be
    told from it.
    """

    key: Key
    validated: ValidatedFit
    probability: float
    alike: Sequence[Key] = ()


def _candidate(
    entry: _Entry, base: ValidatedFit, number: int, stds: Mapping[str, float], search: Search
) -> Candidate:
    """What is said of an effect that was added to the structure `base`, after `number` others."""
    key, validated = entry.key, entry.validated
    # of an accepted one the values beside all others are told
    accepted = key in search.best.keys
    told = search.best if accepted else validated
    use = next(use for use in told.model.effects if use.key == key)
    parameters = use.parameters
    stds = stds if accepted else search.validation.doubts(told.structure)
    doubts = {
        name: 0.0 if p.fixed else stds.get(f"{use.label}.{name}", np.inf)
        for name, p in parameters.items()
    }
    before, after = base.rms, validated.rms
    # the output whose error falls most; one without any error has no ratio
    with np.errstate(invalid="ignore", divide="ignore"):
        o = int(np.nanargmin(after / before))
    output = list(validated.model.outputs.values())[o]
    return Candidate(
        effect=key.effect,
        balance=key.target,
        probability=float(entry.probability),
        alike=tuple(entry.alike),
        parameters={
            name: Quantity(p.value, doubts[name], p.unit) for name, p in parameters.items()
        },
        error_before=float(before[o]),
        error_after=float(after[o]),
        error_unit=output.unit,
        output=output.name,
        within_bounds=not _at_a_bound(parameters, find_effect(key.effect).natural_bounds),
        evidence=evidence(validated, base, search.validation.scale),
        held_out=True,
        share=share_of(base, validated),
        step=number,
    )


def _at_a_bound(parameters: Mapping[str, Parameter], natural: Collection[str]) -> bool:
    """Whether an estimated value lies at a bound at which no such effect would."""
    return any(
        not p.fixed and name not in natural and p.value in (p.lower, p.upper)
        for name, p in parameters.items()
    )


def share_of(before: ValidatedFit, after: ValidatedFit) -> Quantity:
    """Part of the error's power that is taken away on unseen blocks, the outputs alike, with its
    scatter over blocks.
    """
    return Quantity(*share(before.squares, after.squares), "")


# What a model leaves on unseen blocks, and when.


@dataclass(frozen=True)
class Remaining:
    """What a model leaves on unseen blocks. `share` is of the power that the model left as it was,
    `times_noise` the largest RMS error over its measurement noise. `where` (from, to) [s] is the
    block of time in which most of it lies.
    """

    share: float
    times_noise: float
    where: tuple[float, float]


def remaining(base: ValidatedFit, best: ValidatedFit, validation: CrossValidation) -> Remaining:
    """What `best` leaves of what `base` left."""
    data = validation.data
    noise = np.nan_to_num(noise_floor(np.concatenate([e.Y for e in data.experiments])))
    times = best.rms[data.measured] / np.where(noise > 0.0, noise, np.nan)[data.measured]
    largest = float(np.nanmax(times)) if np.isfinite(times).any() else float("inf")
    where = int(np.argmax(validation.scale.by_block(best.power)))
    return Remaining(1.0 - share_of(base, best).value, largest, data.times_of(where))


# Errors block by block on unseen blocks: when in the record a model fails, and what each
# candidate would take away there.


@dataclass(frozen=True, eq=False)
class BlockErrors:
    """RMS errors on blocks that no fit has seen.

    Attributes
    ----------
    outputs, units : tuple of str
        Of the outputs that were measured.
    records : tuple of int
        The record of each block, from 0.
    times : tuple of (float, float)
        Begin and end of each block [s], in its record's time.
    before, after : array, shape (blocks, outputs)
        Of the model as it is, re-estimated, and with every effect that was accepted; NaN where
        nothing was measured.
    candidates : mapping of Key to array, shape (blocks, outputs)
        Of the model with one effect alone.
    """

    outputs: tuple[str, ...]
    units: tuple[str, ...]
    records: tuple[int, ...]
    times: tuple[tuple[float, float], ...]
    before: FloatArray
    after: FloatArray
    candidates: Mapping[Key, FloatArray]


def block_errors(search: Search, candidates: Sequence[Candidate]) -> BlockErrors:
    """Errors of a search's model as it is, of its best structure, and of each candidate alone."""
    data, base = search.validation.data, search.base
    blocks = range(data.blocks)
    observed = base.count.sum(axis=0) > 0.0
    measured = zip(data.model.outputs.values(), observed, strict=True)
    outputs = [output for output, is_observed in measured if is_observed]
    n = base.count[:, observed]

    def rms(squares: FloatArray) -> FloatArray:
        nothing = np.full(n.shape, np.nan)
        return np.sqrt(np.divide(squares[:, observed], n, out=nothing, where=n > 0.0))

    first = [candidate.key for candidate in candidates if candidate.step == 0]
    return BlockErrors(
        outputs=tuple(output.name for output in outputs),
        units=tuple(output.unit for output in outputs),
        records=tuple(block * len(data.experiments) // data.blocks for block in blocks),
        times=tuple(data.times_of(block) for block in blocks),
        before=rms(base.squares),
        after=rms(search.best.squares),
        candidates={
            key: rms(search.every[(key,)].squares) for key in first if (key,) in search.every
        },
    )
