"""Which effect takes away most of what is missing, and is that real? The judge for models that are wrong.

Every candidate is estimated on the training blocks and judged on the others. Its *share* is the part of the error's power
that it takes away there, with a standard error over blocks; it is *real* where the paired difference of the blocks' predictive
densities stands several standard errors above zero. A block's density is that of errors whose scale nobody knows, −½ log of its
power: one violent block counts once. The scatter between blocks carries what the model gets wrong elsewhere; the number of
samples does not. Candidates whose paired difference from the leading one cannot be told from zero form its group, and the
simplest of them leads.

References
----------
A. Vehtari, A. Gelman, J. Gabry, Stat. Comput. 27 (2017) 1413; Y. Yao et al., Bayesian Anal. 13 (2018) 917 (stacking when no model
is true); L. Breiman et al., *Classification and Regression Trees*, 1984, section 3.4.3 (the one-standard-error rule).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy import stats

from residuum.identification.discrepancy.deadline import OutOfTime, in_time
from residuum.identification.discrepancy.held_out_blocks import Blocks, Errors, blocks_on_track, cross_judged, fitted
from residuum.identification.discrepancy.noise_floor import PLAINLY
from residuum.identification.discrepancy.proposals import Key, curves, starts
from residuum.identification.discrepancy.side_by_side import each_beside
from residuum.identification.physics import Experiment, PhysicalModel, candidates
from residuum.identification.physics.model import find_effect, tied_to

FloatArray = npt.NDArray[np.float64]

LEVEL = 0.01
"""Probability that chance alone makes an effect real, all candidates counted (Bonferroni)."""
PLAIN_LEVEL = 0.05
"""The same of one candidate where the error stands so far above the noise that something is missing for certain."""
LEAST = 0.05
"""Share of what is left that an effect has to take away to be worth its name."""
ALIKE = 2.0
"""Standard errors within which two candidates cannot be told apart."""
_MUCH = 0.5
"""Part of the leading one's share that another has to take away to stand for it."""
_TRIFLE = 0.01
"""Part of the mean power of a block that is too small to matter, of noise or of anything."""
_PROMISE = 0.02
"""Part of the sum of squares that an effect has to take away where it was estimated to be tried on blocks kept aside."""
_STEPS = 4
_RESAMPLES = 400


@dataclass(frozen=True, eq=False)
class Shared:
    """One candidate on the blocks kept aside: `share` ± `std` of the error's power, its errors and the p-value of "no better"."""

    key: Key
    model: PhysicalModel
    share: float
    std: float
    p_value: float
    errors: Errors

    @property
    def simplicity(self) -> int:
        """Number of free parameters, own states and signals from outside the balance, fewest first."""
        use = self.model.effects[-1]
        free = sum(not p.fixed for p in use.parameters.values())
        return free + len(use.effect.states(self.model.site(use.target, use.effect))) + len(tied_to(use.target))


@dataclass(frozen=True, eq=False)
class ShareStep:
    """One step: the model before it, its errors, all candidates (the leading first), and the group of the first.

    `wins` is how often each of the group leads when blocks are resampled; `accepted` is None where none is real; `tried` is the
    part of the candidates that there was time for.
    """

    base: PhysicalModel
    before: Errors
    judged: tuple[Shared, ...]
    group: tuple[Key, ...]
    wins: Mapping[Key, float]
    accepted: Shared | None
    tried: float = 1.0


@dataclass(eq=False)
class ShareSearch:
    """The steps taken, and the blocks of the first."""

    blocks: Blocks
    steps: list[ShareStep] = field(default_factory=list)

    @property
    def accepted(self) -> list[Key]:
        """The effects that joined, one a step."""
        return [step.accepted.key for step in self.steps if step.accepted is not None]

    @property
    def model(self) -> PhysicalModel:
        """The base with them, estimated on the training blocks."""
        joined = [step.accepted.model for step in self.steps if step.accepted is not None]
        return joined[-1] if joined else self.steps[0].base


def search_by_share(
    model: PhysicalModel, experiments: Sequence[Experiment], effects: Sequence[str] | None = None, *, learned: bool = False
) -> ShareSearch | None:
    """Grow the model by the effects that take away most on blocks kept aside, while one is real.

    Parameters
    ----------
    model : PhysicalModel
    experiments : sequence of Experiment
        Whole records; the blocks are cut here.
    effects : sequence of effect id
        Consider only these (default: all that fit).
    learned : bool
        Where no effect with a name is real, learn a curve over one signal.

    Returns
    -------
    The search, or None where the records are too short for blocks or no filter follows them.

    Notes
    -----
    Fails where an effect shows only over times longer than a block, and sees little where most of a block's error is noise.
    """
    found: ShareSearch | None = None
    current = model
    for _ in range(_STEPS):
        try:
            blocks = blocks_on_track(current, experiments)
            base = None if blocks is None else cross_judged(current, blocks)
        except OutOfTime:
            return found
        if blocks is None or base is None:
            return found
        before = base[1]
        found = found or ShareSearch(blocks)
        taken = found.accepted
        keys = _simplest_first(base[0], [key for key in candidates(base[0], effects) if key not in taken])
        step = _step(base[0], blocks, experiments, before, keys, first=not taken)
        if step.accepted is None and learned:
            step = _step(base[0], blocks, experiments, before, curves(base[0], blocks), first=not taken)
        found.steps.append(step)
        if step.accepted is None:
            break
        current = step.accepted.model
    return found


def _step(
    base: PhysicalModel, blocks: Blocks, experiments: Sequence[Experiment], before: Errors, keys: Sequence[Key], *, first: bool
) -> ShareStep:
    few = blocks.few
    start = fitted(base, few, look=True) if len(few.train) < len(blocks.train) else None
    glanced = np.inf if start is None else start[1]

    late: list[Key] = []

    def one(key: Key) -> Shared | None:
        try:
            return _shared(base, key, blocks, experiments, before, glanced)
        except OutOfTime:
            late.append(key)
            return None

    judged = [s for s in each_beside(one, keys) if s is not None]
    judged.sort(key=lambda s: -s.share)
    if not judged:
        return ShareStep(base, before, (), (), {}, None)
    worth = max(LEAST, _MUCH * judged[0].share)
    alike = [s for s in judged if s.share > worth and _behind(s, judged[0], before) < ALIKE]
    certain = first and before.stands_out(blocks.noise, PLAINLY)
    level = PLAIN_LEVEL if certain else LEVEL / len(keys)
    real = [s for s in alike if s.p_value < level]
    leading = min(real, key=lambda s: (s.simplicity, -round(s.share, 2)), default=None)
    ordered = sorted(judged, key=lambda s: (s is not leading, s not in alike))
    group = tuple(s.key for s in ordered if s in alike) if leading is not None else ()
    wins, tried = _wins([s for s in judged if s in alike], before), 1.0 - len(late) / len(keys)
    return ShareStep(base, before, tuple(ordered), group, wins, leading, tried)


def _simplest_first(model: PhysicalModel, keys: Sequence[Key]) -> list[Key]:
    """Effects with few parameters before those with many: what there is no time for would not have led a tie."""

    def weight(key: Key) -> int:
        effect = find_effect(key[0])
        site = model.site(key[1], effect)
        return sum(not p.fixed for p in effect.parameters(site)) + 2 * len(effect.states(site)) - 2 * len(tied_to(key[1]))

    return sorted(keys, key=weight)


def _shared(
    base: PhysicalModel, key: Key, blocks: Blocks, experiments: Sequence[Experiment], before: Errors, glanced: float
) -> Shared | None:
    """The candidate at the best of its starts, judged; None where it diverges or promises nothing.

    `glanced` is the weighted sum of squares of the model without it on the few blocks where the starts are looked at, infinite
    where those are all and nothing is gained by leaving a candidate early.
    """
    few = blocks.few
    looks = [found for start in starts(base, key, blocks, experiments) if (found := fitted(start, few, look=True))]
    if not looks or min(found[1] for found in looks) > (1.0 - _PROMISE) * glanced:
        return None
    in_time()
    best = cross_judged(min(looks, key=lambda found: found[1])[0], blocks)
    if best is None:
        return None
    errors = best[1]
    gain = before.relative(before) - errors.relative(before)
    n = len(gain)
    fall = _loss(before, before) - _loss(errors, before)
    scatter = float(fall.std(ddof=1) / np.sqrt(n))
    p_value = float(stats.t.sf(fall.mean() / scatter, n - 1)) if scatter > 0.0 else 1.0
    return Shared(key, best[0], float(gain.sum()), float(np.sqrt(n) * gain.std(ddof=1)), p_value, errors)


def _loss(errors: Errors, base: Errors) -> FloatArray:
    """Half the logarithm of each block's power; what is a `_TRIFLE` beside the mean of all blocks of the base does not count."""
    power = errors.relative(base)
    return np.asarray(0.5 * np.log(power + _TRIFLE / len(power)))


def _behind(one: Shared, leading: Shared, before: Errors) -> float:
    """How many standard errors the candidate's blocks stand behind the leading one's."""
    behind = _loss(one.errors, before) - _loss(leading.errors, before)
    scatter = float(behind.std(ddof=1) / np.sqrt(len(behind)))
    return float(behind.mean()) / scatter if scatter > 0.0 else 0.0


def _wins(group: Sequence[Shared], before: Errors) -> dict[Key, float]:
    """How often each takes away most when blocks are drawn again with replacement."""
    if not group:
        return {}
    power = np.array([s.errors.relative(before) for s in group])
    rows = np.random.default_rng(0).integers(0, power.shape[1], size=(_RESAMPLES, power.shape[1]))
    best = np.argmin(power[:, rows].sum(axis=2), axis=0)
    return {s.key: float(np.mean(best == k)) for k, s in enumerate(group)}
