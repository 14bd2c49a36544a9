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
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.special import stdtr

from residuum.identification.discrepancy.held_out_blocks import Blocks, Errors, Fitted, cross_judged, looked_at
from residuum.identification.discrepancy.policy.blocks import (
    AS_GOOD,
    COMPARABLE_SHARE,
    FOLLOWED_STARTS,
    LEAST_SHARE,
    NEARLY_THE_SHARE,
    PROMISED_FALL,
    REAL,
    RESAMPLES,
    TOLD_APART,
    TRIFLE,
)
from residuum.identification.discrepancy.proposals import starts
from residuum.identification.physics import Experiment, Key, PhysicalModel
from residuum.identification.physics.model import find_effect, tied_to
from residuum.identification.residual_analysis.policy.noise import BEYOND_NOISE
from residuum.identification.side_by_side import each_beside
from residuum.identification.work import OutOfWork, go_on, left_out

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Shared:
    """One candidate on the blocks kept aside: `share` ± `std` of the error's power, its errors and the p-value of "no better".

    `simplicity` is the number of its free parameters, own states and signals from outside the balance: fewest first.
    """

    key: Key
    model: PhysicalModel
    share: float
    std: float
    p_value: float
    errors: Errors
    simplicity: int


@dataclass(frozen=True, eq=False)
class ShareStep:
    """One step: the model before it, its errors, all candidates (the leading first), and the group of the first.

    `wins` is how often each of the group leads when blocks are resampled; `accepted` is None where none is real; `tried` is the
    part of the candidates that there was work left for; `real` are those that chance does not explain, by share.
    """

    base: PhysicalModel
    before: Errors
    judged: tuple[Shared, ...]
    group: tuple[Key, ...]
    wins: Mapping[Key, float]
    accepted: Shared | None
    tried: float = 1.0
    real: tuple[Shared, ...] = ()

    def led_by(self, leading: Shared | None) -> ShareStep:
        """The same step with another one accepted, which leads its candidates; nothing is a group where none is."""
        if leading is None:
            return replace(self, group=(), accepted=None)
        group = (leading.key, *(key for key in self.group if key != leading.key))
        ordered = sorted(self.judged, key=lambda s: (s is not leading, s.key not in group))
        return replace(self, judged=tuple(ordered), group=group, accepted=leading)

    @property
    def simplest(self) -> Shared | None:
        """The real one with fewest parameters, of those that with most share."""
        return min(self.real, key=lambda s: (s.simplicity, -s.share), default=None)


def share_step(blocks: Blocks, experiments: Sequence[Experiment], before: Errors, keys: Sequence[Key]) -> ShareStep:
    """All candidates judged on the blocks, `before` the errors there of the model without any of them."""
    base = blocks.base.model
    late, keys = [], _simplest_first(base, keys)

    def one(key: Key) -> Shared | None:
        try:
            go_on()
            return _shared(key, blocks, experiments, before)
        except OutOfWork:
            late.append(key)
            left_out(f"{key.effect}@{key.target}")
            return None

    judged = [s for s in each_beside(one, keys) if s is not None]
    judged.sort(key=lambda s: -s.share)
    if not judged:
        return ShareStep(base, before, (), (), {}, None)
    worth = max(LEAST_SHARE, COMPARABLE_SHARE * judged[0].share)
    alike = [s for s in judged if s.share > worth and _behind(s, judged[0], before) < TOLD_APART]
    level = REAL if before.stands_out(blocks.noise, BEYOND_NOISE) else REAL / len(keys)
    real = tuple(s for s in judged if s.share > worth and s.p_value < level)
    leading = preferred([s for s in real if s in alike], before)
    group = tuple(s.key for s in alike)
    wins, tried = _wins([s for s in judged if s in alike], before), 1.0 - len(late) / len(keys)
    return ShareStep(base, before, tuple(judged), group, wins, None, tried, real).led_by(leading)


def preferred(real: Sequence[Shared], before: Errors) -> Shared | None:
    """The simplest of those that take away nearly what the best does and stand less than a standard error behind it."""
    if not real:
        return None
    near = [s for s in real if s.share > NEARLY_THE_SHARE * real[0].share and _behind(s, real[0], before) < AS_GOOD]
    return min(near, key=lambda s: (s.simplicity, -round(s.share, 2)))


def _simplest_first(model: PhysicalModel, keys: Sequence[Key]) -> list[Key]:
    """Effects with few parameters before those with many: what there is no work left for would not have led a tie."""

    def weight(key: Key) -> int:
        effect = find_effect(key[0])
        site = model.site(key[1], effect)
        return sum(not p.fixed for p in effect.parameters(site)) + 2 * len(effect.states(site)) - 2 * len(tied_to(key[1]))

    return sorted(keys, key=weight)


def _shared(key: Key, blocks: Blocks, experiments: Sequence[Experiment], before: Errors) -> Shared | None:
    """The candidate at the best of its starts, judged; None where it diverges or promises nothing."""
    looks = [look for start in starts(key, blocks, experiments) if (look := looked_at(start, blocks)) is not None]
    if not looks or min(look.cost for look in looks) > (1.0 - PROMISED_FALL) * blocks.base.cost:
        return None
    go_on()
    found = None
    for look in sorted(looks, key=lambda look: look.cost)[:FOLLOWED_STARTS]:
        crossed = cross_judged(look, blocks)
        found = found if crossed is None else judged_against(before, key, crossed)
        if found is not None and found.share > 0.0:
            break
    return found


def judged_against(before: Errors, key: Key, found: tuple[Fitted, Errors]) -> Shared:
    """What an estimate with the effect takes away of the errors `before` on the blocks kept aside."""
    fitted, errors = found
    gain = before.relative(before) - errors.relative(before)
    n = len(gain)
    fall = _loss(before, before) - _loss(errors, before)
    scatter = float(fall.std(ddof=1) / np.sqrt(n))
    p_value = float(stdtr(n - 1, -fall.mean() / scatter)) if scatter > 0.0 else 1.0
    std = float(np.sqrt(n) * gain.std(ddof=1))
    return Shared(key, fitted.model, float(gain.sum()), std, p_value, errors, _simplicity(fitted.model))


def _simplicity(model: PhysicalModel) -> int:
    use = model.effects[-1]
    free = sum(not p.fixed for p in use.parameters.values())
    return free + len(use.effect.states(model.site(use.target, use.effect))) + len(tied_to(use.target))


def _loss(errors: Errors, base: Errors) -> FloatArray:
    """Half the logarithm of each block's power; what is a `TRIFLE` beside the mean of all blocks of the base does not count."""
    power = errors.relative(base)
    return np.asarray(0.5 * np.log(power + TRIFLE / len(power)))


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
    rows = np.random.default_rng(0).integers(0, power.shape[1], size=(RESAMPLES, power.shape[1]))
    best = np.argmin(power[:, rows].sum(axis=2), axis=0)
    return {s.key: float(np.mean(best == k)) for k, s in enumerate(group)}
