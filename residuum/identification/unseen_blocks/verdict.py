"""From what was tried to names: groups, probabilities that were counted, and the verdict.

Blocks are drawn again with replacement; in every draw the structure wins that would have been
chosen on those blocks. What a group, "none" and "unknown" win is their probability. A name that
took a part, or that acts when nobody recorded, shares what it wins with "unknown": no draw of
blocks shows what else would have done the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.physics import Key, PhysicalModel, noise_floor
from residuum.identification.physics.model import find_effect
from residuum.identification.unseen_blocks.comparing import evidence, is_alike, share
from residuum.identification.unseen_blocks.free_term import BlockTerm
from residuum.identification.unseen_blocks.judged import Judged
from residuum.identification.unseen_blocks.looks import Court
from residuum.identification.unseen_blocks.next_experiment import HELD
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
from residuum.identification.unseen_blocks.tried import Search, chain, in_place_of

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
    the part of the error's power that it takes away on blocks kept aside.
    """

    effect: str
    balance: str
    probability: float
    indistinguishable_from: tuple[str, ...]
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


NONE, UNKNOWN = "none", "unknown"


@dataclass(frozen=True)
class Step:
    """An effect that joined: the structures before and after, those that do the same in its place,
    and what else was tried there.
    """

    key: Key
    before: Judged
    after: Judged
    group: tuple[Judged, ...]
    others: tuple[Judged, ...]


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
    steps = []
    for key, before, after in chain(search, search.best.keys):
        earlier = set(before.keys)
        rivals = [
            o
            for o in search.every.values()
            if set(o.keys) > earlier and len(o.keys) == len(after.keys) and o.keys != after.keys
        ]
        rivals.sort(key=lambda rival: rival.cost)
        alike = [o for o in rivals if is_alike(o, after, before, search.court.scale)]
        if after.keys == search.best.keys:
            alike += [
                o
                for o in search.group
                if o.keys not in {a.keys for a in alike} and set(o.keys) > earlier
            ]
        alike += [
            o
            for o in in_place_of(search, key, before.keys)
            if o.keys not in {a.keys for a in alike}
        ]
        # What does not lower the error beyond its price has no probability to share, however near
        # it lies.
        alike = [o for o in alike if o.cost < before.cost]
        steps.append(
            Step(key, before, after, tuple(alike), tuple(o for o in rivals if o not in alike))
        )
    return steps


def counted(
    search: Search, free: Sequence[BlockTerm], *, adequate: bool
) -> dict[tuple[Key, ...] | str, float]:
    """How often each structure wins when blocks are drawn again. Where none is worth its place,
    "none" wins if the model is `adequate`, else "unknown". "unknown" wins also where a free term
    does plainly more of what is structured. What fits all blocks no better than the model as it is
    wins nowhere: where one block tells a value alone, deletion is ahead in every draw that has that
    block.
    """
    scale = search.court.scale
    free = [] if adequate else free
    fitting = [
        rival for rival in search.every.values() if not rival.keys or rival.seen < search.base.seen
    ]
    tried = sorted(fitting, key=lambda rival: rival.cost)[:MOST_RIVALS]
    powers = [scale.by_block(rival.power) for rival in tried] + [
        scale.by_block(term.power) for term in free
    ]
    names: list[tuple[Key, ...] | str] = [rival.keys or NONE for rival in tried] + [UNKNOWN] * len(
        free
    )
    sizes = np.array([rival.parameters for rival in tried] + [term.parameters for term in free])
    by_block, base = np.array(powers), scale.by_block(search.base.power)
    pick = np.random.default_rng(0).integers(0, by_block.shape[1], (DRAWS, by_block.shape[1]))
    costs = by_block[:, pick].sum(axis=2) + (scale.price * sizes[:, None] if scale.nats else 0.0)
    nothing = base[pick].sum(axis=1) + (scale.price * search.base.parameters if scale.nats else 0.0)
    lead = costs.min(axis=0)
    near = costs < (lead + TIE if scale.nats else 1.1 * lead)
    winner = np.argmin(
        np.where(near, sizes[:, None] + 1e-9 * costs / np.maximum(lead, 1e-300), np.inf), axis=0
    )
    gain = nothing - costs[winner, np.arange(DRAWS)]
    asked = (
        np.log(max(search.tried, 1)) + TIE
        if scale.nats
        else np.maximum(WORTH * (nothing - scale.floor), SMALL)
    )
    wins: dict[tuple[Key, ...] | str, float] = {}
    for k, worth in zip(winner.tolist(), gain > asked, strict=True):
        name = names[k] if worth and names[k] != NONE else (NONE if adequate else UNKNOWN)
        wins[name] = wins.get(name, 0.0) + 1.0 / DRAWS
    return wins


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
    timing = {step.key for step in joined if is_timing(step.key, search)}
    if not joined:  # what was tried, and is a shift by less than a sample, is no physics either
        timing = {
            fit.keys[0]
            for fit in search.every.values()
            if len(fit.keys) == 1 and is_timing(fit.keys[0], search, fit.model)
        }
    wins = _named(counted(search, free, adequate=adequate), timing, NONE if adequate else UNKNOWN)
    steps = [step for step in joined if step.key not in timing]
    if steps and (not _recorded(steps) or (not adequate and _took_a_part(search))):
        wins = _doubted(wins)
    listed: list[Candidate] = []
    for number, step in enumerate(step for step in steps if step.key.effect != HELD):
        listed += _candidates(step, number, wins, stds, search)
    if not steps:
        listed = _undecided(search, wins, stds, timing)
    unknown, none = wins.get(UNKNOWN, 0.0), wins.get(NONE, 0.0)
    named = sum(c.probability for c in listed if c.step == 0)
    excess = max(named + none + unknown, 1.0)
    listed = [_scaled(c, 1.0 / excess) for c in listed]
    named_one = any(step.key.effect != HELD for step in steps)
    if steps and unknown >= UNKNOWN_LEADS:
        says = "unknown-effect"
    elif named_one and any(c.probability > 0.0 for c in listed):
        says = "missing-effect"
    else:
        says = "adequate" if adequate else "unknown-effect"
    remainder = max(0.0, 1.0 - named / excess - none / excess)
    return Verdict(says, tuple(listed), none / excess, remainder)


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


def _recorded(steps: Sequence[Step]) -> bool:
    """Whether the records say when the effects that joined act: a load that came and went once may
    have been anything.
    """
    return all(step.key.effect == HELD or step.after.model.records(step.key) for step in steps)


def _took_a_part(search: Search) -> bool:
    """Whether plainly more than noise is left of the error: the nearest shape in the catalogue to
    something else does that.
    """
    scale, base = search.court.scale, search.base
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


def _scaled(candidate: Candidate, factor: float) -> Candidate:
    return replace(candidate, probability=candidate.probability * factor)


def is_timing(key: Key, search: Search, model: PhysicalModel | None = None) -> bool:
    """Whether an effect of the best model, or of this one, shifts time by less than a sample: how
    the record was taken, not physics.
    """
    shift = "" if key.effect == HELD else find_effect(key.effect).shifts
    if not shift:
        return False
    use = next(use for use in (model or search.best.model).effects if use.key == key)
    return abs(use.parameters[shift].value) < max(
        e.sample_time for e in search.court.data.experiments
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

    What won beside the group won nothing in its place.
    """
    earlier = set(step.before.keys)
    group = {step.key: step.after} | {
        _added(rival, earlier): rival for rival in step.group if _is_one(rival, earlier)
    }
    rivals = {_added(rival, earlier): rival for rival in step.others if _is_one(rival, earlier)}
    won = [(set(keys), w) for keys, w in wins.items() if not isinstance(keys, str)]
    together = sum(w for keys, w in won if keys & group.keys())
    shares = {
        key: sum(w for keys, w in won if key in keys and not keys & group.keys()) for key in rivals
    }
    named = [key for key in group if key.effect != HELD]
    listed = [
        _candidate(
            key,
            group[key],
            step,
            number,
            together / len(named),
            [k for k in named if k != key],
            stds,
            search,
        )
        for key in named
    ]
    leading = sorted(
        (k for k in rivals if k.effect != HELD), key=lambda k: (-shares[k], rivals[k].cost)
    )[: LISTED if number == 0 else 0]
    listed += [
        _candidate(
            key, rivals[key], step, number, 0.0 if earlier else shares[key], [], stds, search
        )
        for key in leading
    ]
    return listed


def _is_one(rival: Judged, earlier: set[Key]) -> bool:
    return len(set(rival.keys) - earlier) == 1


def _added(rival: Judged, earlier: set[Key]) -> Key:
    return next(iter(set(rival.keys) - earlier))


def _undecided(
    search: Search,
    wins: Mapping[tuple[Key, ...] | str, float],
    stds: Mapping[str, float],
    timing: set[Key],
) -> list[Candidate]:
    """Nothing is real: those that took away most are told with what they win."""
    alone = sorted(
        (fit for fit in search.every.values() if len(fit.keys) == 1), key=lambda fit: fit.cost
    )[:LISTED]
    step = Step(Key("", ""), search.base, search.base, (), ())
    listed = [
        fit
        for fit in alone
        if fit.keys[0].effect != HELD and fit.keys[0] not in timing and fit.cost < search.base.cost
    ]
    return [
        _candidate(fit.keys[0], fit, step, 0, wins.get(fit.keys, 0.0), [], stds, search)
        for fit in listed
    ]


def _candidate(
    key: Key,
    judged: Judged,
    step: Step,
    number: int,
    probability: float,
    alike: Sequence[Key],
    stds: Mapping[str, float],
    search: Search,
) -> Candidate:
    use = next(use for use in judged.model.effects if use.key == key)
    accepted = key in search.best.keys
    values = (
        next(u for u in search.best.model.effects if u.key == key).parameters
        if accepted
        else use.parameters
    )
    doubts = {
        n: float(stds.get(f"{use.label}.{n}", 0.0)) if accepted and not p.fixed else 0.0
        for n, p in values.items()
    }
    before, after = step.before.rms, judged.rms
    with np.errstate(invalid="ignore", divide="ignore"):
        o = int(np.nanargmin(after / before))
    output = list(judged.model.outputs.values())[o]
    natural = find_effect(key.effect).natural_bounds
    bounds = [
        n
        for n, p in values.items()
        if not p.fixed and n not in natural and p.value in (p.lower, p.upper)
    ]
    return Candidate(
        effect=key.effect,
        balance=key.target,
        probability=float(probability),
        indistinguishable_from=tuple(k.effect for k in alike),
        parameters={n: Quantity(p.value, doubts[n], p.unit) for n, p in values.items()},
        error_before=float(before[o]),
        error_after=float(after[o]),
        error_unit=output.unit,
        output=output.name,
        within_bounds=not bounds,
        evidence=evidence(judged, step.before, search.court.scale),
        held_out=True,
        share=share_of(step.before, judged),
        step=number,
    )


def share_of(before: Judged, after: Judged) -> Quantity:
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


def remaining(base: Judged, best: Judged, court: Court) -> Remaining:
    """What `best` leaves of what `base` left."""
    data = court.data
    noise = np.nan_to_num(noise_floor(np.concatenate([e.Y for e in data.experiments])))
    times = best.rms[data.measured] / np.where(noise > 0.0, noise, np.nan)[data.measured]
    largest = float(np.nanmax(times)) if np.isfinite(times).any() else float("inf")
    where = int(np.argmax(court.scale.by_block(best.power)))
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


def block_errors(
    model: PhysicalModel,
    records: Sequence[int],
    times: Sequence[tuple[float, float]],
    count: FloatArray,
    before: FloatArray,
    after: FloatArray,
    candidates: Mapping[Key, FloatArray],
) -> BlockErrors:
    """From sums of squares and how many samples they are of, arrays of shape (blocks, outputs); see
    BlockErrors.
    """
    observed = count.sum(axis=0) > 0.0
    outputs = [
        output
        for output, measured in zip(model.outputs.values(), observed, strict=True)
        if measured
    ]

    def rms(squares: FloatArray) -> FloatArray:
        n = count[:, observed]
        return np.sqrt(
            np.divide(squares[:, observed], n, out=np.full(n.shape, np.nan), where=n > 0.0)
        )

    return BlockErrors(
        outputs=tuple(output.name for output in outputs),
        units=tuple(output.unit for output in outputs),
        records=tuple(records),
        times=tuple(times),
        before=rms(before),
        after=rms(after),
        candidates={key: rms(squares) for key, squares in candidates.items()},
    )
