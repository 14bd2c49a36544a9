"""From what was tried to names: groups, probabilities that were counted, and the verdict.

Blocks are drawn again with replacement; in every draw the structure wins that would have been chosen on those blocks. What a
group, "none" and "unknown" win is their probability. A name that took a part, or that acts when nobody recorded, shares what it
wins with "unknown": no draw of blocks shows what else would have done the same.
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

    `step` counts the effects that were accepted before it; `evidence` is its log odds against "nothing more is missing";
    the errors are RMS simulation errors of `output` before and after it was added, on data that were not used for the
    estimation where `held_out` says so; `share` is the part of the error's power that it takes away on blocks kept aside.
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
    """An effect that joined: the structures before and after, those that do the same in its place, and what else was tried
    there.
    """

    key: Key
    before: Judged
    after: Judged
    group: tuple[Judged, ...]
    others: tuple[Judged, ...]


@dataclass(frozen=True)
class Verdict:
    """What is said: probabilities of nothing and of something without a name, and the candidates, the accepted ones first."""

    verdict: str
    candidates: tuple[Candidate, ...]
    none: float
    unknown: float


def steps_of(found: Search) -> list[Step]:
    """The effects that joined, in the order in which each takes away most."""
    steps = []
    for key, before, after in chain(found, found.best.keys):
        rest = set(before.keys)
        there = [
            o for o in found.every.values() if set(o.keys) > rest and len(o.keys) == len(after.keys) and o.keys != after.keys
        ]
        there.sort(key=lambda one: one.cost)
        alike = [o for o in there if is_alike(o, after, before, found.court.scale)]
        if after.keys == found.best.keys:
            alike += [o for o in found.group if o.keys not in {a.keys for a in alike} and set(o.keys) > rest]
        alike += [o for o in in_place_of(found, key, before.keys) if o.keys not in {a.keys for a in alike}]
        # What does not lower the error beyond its price has no probability to share, however near it lies.
        alike = [o for o in alike if o.cost < before.cost]
        steps.append(Step(key, before, after, tuple(alike), tuple(o for o in there if o not in alike)))
    return steps


def counted(found: Search, free: Sequence[BlockTerm], *, adequate: bool) -> dict[tuple[Key, ...] | str, float]:
    """How often each structure wins when blocks are drawn again. Where none is worth its place, "none" wins if the model is
    `adequate`, else "unknown". "unknown" wins also where a free term does plainly more of what is structured. What fits all
    blocks no better than the model as it is wins nowhere: where one block tells a value alone, deletion is ahead in every draw
    that has that block.
    """
    scale = found.court.scale
    free = [] if adequate else free
    fitting = [one for one in found.every.values() if not one.keys or one.seen < found.base.seen]
    tried = sorted(fitting, key=lambda one: one.cost)[:MOST_RIVALS]
    powers = [scale.by_block(one.power) for one in tried] + [scale.by_block(term.power) for term in free]
    names: list[tuple[Key, ...] | str] = [one.keys or NONE for one in tried] + [UNKNOWN] * len(free)
    sizes = np.array([one.parameters for one in tried] + [term.parameters for term in free])
    by_block, base = np.array(powers), scale.by_block(found.base.power)
    pick = np.random.default_rng(0).integers(0, by_block.shape[1], (DRAWS, by_block.shape[1]))
    costs = by_block[:, pick].sum(axis=2) + (scale.price * sizes[:, None] if scale.nats else 0.0)
    nothing = base[pick].sum(axis=1) + (scale.price * found.base.parameters if scale.nats else 0.0)
    lead = costs.min(axis=0)
    near = costs < (lead + TIE if scale.nats else 1.1 * lead)
    winner = np.argmin(np.where(near, sizes[:, None] + 1e-9 * costs / np.maximum(lead, 1e-300), np.inf), axis=0)
    gain = nothing - costs[winner, np.arange(DRAWS)]
    asked = np.log(max(found.tried, 1)) + TIE if scale.nats else np.maximum(WORTH * (nothing - scale.floor), SMALL)
    wins: dict[tuple[Key, ...] | str, float] = {}
    for k, worth in zip(winner.tolist(), gain > asked, strict=True):
        name = names[k] if worth and names[k] != NONE else (NONE if adequate else UNKNOWN)
        wins[name] = wins.get(name, 0.0) + 1.0 / DRAWS
    return wins


def verdict_on(
    found: Search, joined: Sequence[Step], free: Sequence[BlockTerm], stds: Mapping[str, float], *, adequate: bool
) -> Verdict:
    """The verdict on the steps that `joined`; `adequate`: whether nothing is structured in what the best structure leaves."""
    timing = {step.key for step in joined if is_timing(step.key, found)}
    if not joined:  # what was tried, and is a shift by less than a sample, is no physics either
        timing = {one.keys[0] for one in found.every.values() if len(one.keys) == 1 and is_timing(one.keys[0], found, one.model)}
    wins = _named(counted(found, free, adequate=adequate), timing, NONE if adequate else UNKNOWN)
    steps = [step for step in joined if step.key not in timing]
    if steps and (not _recorded(steps) or (not adequate and _took_a_part(found))):
        wins = _doubted(wins)
    listed: list[Candidate] = []
    for number, step in enumerate(step for step in steps if step.key.effect != HELD):
        listed += _candidates(step, number, wins, stds, found)
    if not steps:
        listed = _undecided(found, wins, stds, timing)
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
    rest = max(0.0, 1.0 - named / excess - none / excess)
    return Verdict(says, tuple(listed), none / excess, rest)


def _named(wins: Mapping[tuple[Key, ...] | str, float], timing: set[Key], nothing: str) -> dict[tuple[Key, ...] | str, float]:
    """What was counted, told as `nothing` where no physics is named: a structure of how the record was taken and of values that
    the model holds has none.
    """
    named: dict[tuple[Key, ...] | str, float] = {}
    for keys, won in wins.items():
        physics = isinstance(keys, str) or any(key.effect != HELD and key not in timing for key in keys)
        name = keys if physics else nothing
        named[name] = named.get(name, 0.0) + won
    return named


def _recorded(steps: Sequence[Step]) -> bool:
    """Whether the records say when the effects that joined act: a load that came and went once may have been anything."""
    return all(step.key.effect == HELD or step.after.model.records(step.key) for step in steps)


def _took_a_part(found: Search) -> bool:
    """Whether plainly more than noise is left of the error: the nearest shape in the catalogue to something else does that."""
    scale, base = found.court.scale, found.base
    return not scale.nats and base.cost - found.best.cost < PLAINLY_A_PART * (base.cost - scale.floor)


def _doubted(wins: Mapping[tuple[Key, ...] | str, float]) -> dict[tuple[Key, ...] | str, float]:
    """What was counted, where a name that wins may stand for something that has none."""
    named = sum(won for keys, won in wins.items() if not isinstance(keys, str))
    less = {keys: won if isinstance(keys, str) else (1.0 - DOUBTED) * won for keys, won in wins.items()}
    return {**less, UNKNOWN: less.get(UNKNOWN, 0.0) + DOUBTED * named}


def _scaled(candidate: Candidate, factor: float) -> Candidate:
    return replace(candidate, probability=candidate.probability * factor)


def is_timing(key: Key, found: Search, model: PhysicalModel | None = None) -> bool:
    """Whether an effect of the best model, or of this one, shifts time by less than a sample: how the record was taken, not
    physics.
    """
    shift = "" if key.effect == HELD else find_effect(key.effect).shifts
    if not shift:
        return False
    use = next(use for use in (model or found.best.model).effects if use.key == key)
    return abs(use.parameters[shift].value) < max(e.sample_time for e in found.court.data.experiments)


def _candidates(
    step: Step, number: int, wins: Mapping[tuple[Key, ...] | str, float], stds: Mapping[str, float], found: Search
) -> list[Candidate]:
    """The accepted effect, its group, and what else won draws in its place; a group shares what it wins.

    What won beside the group won nothing in its place.
    """
    rest = set(step.before.keys)
    group = {step.key: step.after} | {_added(one, rest): one for one in step.group if _is_one(one, rest)}
    others = {_added(one, rest): one for one in step.others if _is_one(one, rest)}
    won = [(set(keys), w) for keys, w in wins.items() if not isinstance(keys, str)]
    together = sum(w for keys, w in won if keys & group.keys())
    shares = {key: sum(w for keys, w in won if key in keys and not keys & group.keys()) for key in others}
    named = [key for key in group if key.effect != HELD]
    listed = [
        _candidate(key, group[key], step, number, together / len(named), [k for k in named if k != key], stds, found)
        for key in named
    ]
    told = sorted((k for k in others if k.effect != HELD), key=lambda k: (-shares[k], others[k].cost))[
        : LISTED if number == 0 else 0
    ]
    listed += [_candidate(key, others[key], step, number, 0.0 if rest else shares[key], [], stds, found) for key in told]
    return listed


def _is_one(one: Judged, rest: set[Key]) -> bool:
    return len(set(one.keys) - rest) == 1


def _added(one: Judged, rest: set[Key]) -> Key:
    return next(iter(set(one.keys) - rest))


def _undecided(
    found: Search, wins: Mapping[tuple[Key, ...] | str, float], stds: Mapping[str, float], timing: set[Key]
) -> list[Candidate]:
    """Nothing is real: those that took away most are told with what they win."""
    alone = sorted((one for one in found.every.values() if len(one.keys) == 1), key=lambda one: one.cost)[:LISTED]
    step = Step(Key("", ""), found.base, found.base, (), ())
    told = [one for one in alone if one.keys[0].effect != HELD and one.keys[0] not in timing and one.cost < found.base.cost]
    return [_candidate(one.keys[0], one, step, 0, wins.get(one.keys, 0.0), [], stds, found) for one in told]


def _candidate(
    key: Key,
    one: Judged,
    step: Step,
    number: int,
    probability: float,
    alike: Sequence[Key],
    stds: Mapping[str, float],
    found: Search,
) -> Candidate:
    use = next(use for use in one.model.effects if use.key == key)
    accepted = key in found.best.keys
    values = next(u for u in found.best.model.effects if u.key == key).parameters if accepted else use.parameters
    doubts = {n: float(stds.get(f"{use.label}.{n}", 0.0)) if accepted and not p.fixed else 0.0 for n, p in values.items()}
    before, after = step.before.rms, one.rms
    with np.errstate(invalid="ignore", divide="ignore"):
        o = int(np.nanargmin(after / before))
    output = list(one.model.outputs.values())[o]
    natural = find_effect(key.effect).natural_bounds
    bounds = [n for n, p in values.items() if not p.fixed and n not in natural and p.value in (p.lower, p.upper)]
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
        evidence=evidence(one, step.before, found.court.scale),
        held_out=True,
        share=share_of(step.before, one),
        step=number,
    )


def share_of(before: Judged, after: Judged) -> Quantity:
    """Part of the error's power that is taken away on unseen blocks, the outputs alike, with its scatter over blocks."""
    return Quantity(*share(before.squares, after.squares), "")


# What a model leaves on unseen blocks, and when.


@dataclass(frozen=True)
class Remaining:
    """What a model leaves on unseen blocks. `share` is of the power that the model left as it was, `times_noise` the largest
    RMS error over its measurement noise. `where` (from, to) [s] is the block of time in which most of it lies.
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
        Of the model as it is, re-estimated, and with every effect that was accepted; NaN where nothing was measured.
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
    """From sums of squares and how many samples they are of, arrays of shape (blocks, outputs); see BlockErrors."""
    seen = count.sum(axis=0) > 0.0
    outputs = [output for output, measured in zip(model.outputs.values(), seen, strict=True) if measured]

    def rms(squares: FloatArray) -> FloatArray:
        n = count[:, seen]
        return np.sqrt(np.divide(squares[:, seen], n, out=np.full(n.shape, np.nan), where=n > 0.0))

    return BlockErrors(
        outputs=tuple(output.name for output in outputs),
        units=tuple(output.unit for output in outputs),
        records=tuple(records),
        times=tuple(times),
        before=rms(before),
        after=rms(after),
        candidates={key: rms(squares) for key, squares in candidates.items()},
    )
