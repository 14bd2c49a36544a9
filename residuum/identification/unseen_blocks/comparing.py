"""Which of two structures: paired by block, in the unit of the scale."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.physics.model import find_effect
from residuum.identification.unseen_blocks.policy import (
    BEAM,
    DRAWS,
    EVERYWHERE,
    MERITLESS,
    PIECES,
    REAL,
    SMALL,
    TIE,
    WINDOW_SAMPLES,
    WORTH,
)
from residuum.identification.unseen_blocks.structure import HELD

if TYPE_CHECKING:
    from residuum.identification.unseen_blocks.cross_validation import ValidatedFit
    from residuum.identification.unseen_blocks.scale import Scale


def share(before: FloatArray, after: FloatArray) -> tuple[float, float]:
    """Part of the error's power (blocks, outputs) that is taken away, the outputs alike, and its
    scatter over blocks.
    """
    total = before.sum(axis=0)
    if not (total > 0.0).any():
        return 0.0, 0.0  # there was no error
    by_block = ((before - after)[:, total > 0.0] / total[total > 0.0]).mean(axis=1)
    return float(by_block.sum()), float(np.sqrt(len(by_block)) * by_block.std(ddof=1))


class OnBlocks(Protocol):
    """What has a power on unseen blocks, parameters, and a cost."""

    @property
    def power(self) -> FloatArray:
        """Sums of squares in the scale, shape (blocks, measured outputs)."""

    @property
    def parameters(self) -> float:
        """How many it has that are estimated, or counts as."""

    @property
    def cost(self) -> float:
        """Of the power and the parameters, in the scale."""


def paired(new: OnBlocks, old: OnBlocks, scale: Scale) -> tuple[float, float]:
    """Mean over blocks of the logarithm by which the new one's error is smaller, and its standard
    error.
    """
    p, q = scale.by_block(new.power), scale.by_block(old.power)
    # logarithms, for block powers have heavy tails, to which a t-test of power itself is deaf; with
    # a floor, for a block in which both leave next to nothing would have the largest say
    floor = MERITLESS * min(float(p.mean()), float(q.mean())) + 1e-300
    d = 0.5 * (np.log(q + floor) - np.log(p + floor))
    return float(d.mean()), float(d.std(ddof=1) / np.sqrt(len(d)))


def ahead(new: OnBlocks, old: OnBlocks, scale: Scale) -> float:
    """Standard errors by which the new one's error is smaller. They are of the paired logarithms,
    or of the ratio of totals where a few blocks hold most of the error (a machine that stands still
    in the others).
    """
    p, q = scale.by_block(new.power), scale.by_block(old.power)
    # the scatter of the ratio of totals by a bootstrap over blocks
    pick = np.random.default_rng(0).integers(0, len(p), (DRAWS, len(p)))
    ratios = 0.5 * np.log((q[pick].sum(axis=1) + 1e-300) / (p[pick].sum(axis=1) + 1e-300))
    total = 0.5 * np.log((q.sum() + 1e-300) / (p.sum() + 1e-300))
    return max(block_by_block(new, old, scale), float(total / max(ratios.std(), 1e-12)))


def block_by_block(new: OnBlocks, old: OnBlocks, scale: Scale) -> float:
    """Standard errors by which the new one's error is smaller in one block as in another, however
    much of it a block holds.
    """
    mean, std = paired(new, old, scale)
    return mean / max(std, 1e-12)


def evidence(new: OnBlocks, old: OnBlocks, scale: Scale) -> float:
    """Log odds for the new one: nats gained on unseen blocks, or half the square of the standard
    errors that it is ahead.
    """
    if scale.nats:
        return old.cost - new.cost
    t = ahead(new, old, scale)
    return 0.5 * t * abs(t)


def corrected(new: ValidatedFit, old: ValidatedFit) -> float:
    """Standard errors by which what the new one corrects on unseen blocks goes along with the old
    one's errors. They are summed over pieces as long as the errors are correlated, and
    self-normalised: an effect may show in few places, not in one alone.
    """
    rows = (old.left * (old.left - new.left)).sum(axis=1)
    # autocorrelation ρ of the errors, padded so that the ends do not meet
    e = old.left.sum(axis=1)
    e = e - e.mean()
    rho = np.fft.irfft(np.abs(np.fft.rfft(e, 2 * len(e))) ** 2)[: max(len(e) // 20, 2)]
    rho = rho / max(float(rho[0]), 1e-300)
    # pieces of ten correlation times, 1 + 2 Σ ρ up to where it has decayed
    until = int(np.argmax(rho < 0.05)) or len(rho)
    shortest = min(WINDOW_SAMPLES, max(len(e) // PIECES, 1))
    length = int(np.clip(10 * (1 + 2 * rho[1:until].sum()), shortest, max(len(e) // 20, shortest)))
    # Σs/√Σs²: of one piece that holds everything this is 1, however large it is
    s = np.add.reduceat(rows, np.arange(0, len(rows), length))
    return float(s.sum() / max(float(np.sqrt((s**2).sum())), 1e-300))


def is_real(
    new: ValidatedFit, old: ValidatedFit, base: ValidatedFit, scale: Scale, tried: int
) -> bool:
    """Whether what the new one corrects on unseen blocks is real after so many were tried, and
    worth it; a rare effect more.

    What fits the seen blocks no better is ahead on unseen ones by chance: where one block alone
    tells a value, another value left out with it lies anywhere.
    """
    gain = old.cost - new.cost if new.seen_cost < old.seen_cost else 0.0
    if scale.nats:
        # the logarithm of how many were tried is the price of the choice among them (Bonferroni);
        # and no single place may hold all of the gain
        return (
            gain > np.log(max(tried, 1)) + TIE
            and max(corrected(new, old), block_by_block(new, old, scale)) > EVERYWHERE
        )
    # a share of what is left above the noise, and for the first ones also of the first error
    left, rarer = max(old.cost - scale.floor, 1e-9), max(new.rarity - old.rarity, 0.0)
    least = 0.0 if is_nothing(old, base, scale) else SMALL * (base.cost - scale.floor)
    worth = max(WORTH * (1.0 + rarer) * left, least)
    return gain > worth and ahead(new, old, scale) > REAL


def real_ones(
    ranked: Sequence[ValidatedFit], old: ValidatedFit, base: ValidatedFit, scale: Scale, tried: int
) -> list[ValidatedFit]:
    """Those that are real, without rare ones that do no better than one that is less rare."""
    real = [fit for fit in ranked if is_real(fit, old, base, scale, tried)]
    return [
        fit
        for fit in real
        if not any(rival.rarity < fit.rarity and rival.cost <= fit.cost for rival in ranked)
    ]


def simpler_ones(ranked: Sequence[ValidatedFit], best: ValidatedFit) -> list[ValidatedFit]:
    """Those that leave less than the best with fewer parameters, none of them rarer: what joined
    first stood for two effects together, and took more to do it.
    """
    return [
        rival
        for rival in ranked
        if rival.cost < best.cost
        and rival.parameters < best.parameters
        and rival.rarity <= best.rarity
    ]


def is_nothing(left: ValidatedFit, base: ValidatedFit, scale: Scale) -> bool:
    """Whether what is left is so small a part of the first error that nothing is sought in it."""
    return not scale.nats and left.cost - scale.floor < SMALL * (base.cost - scale.floor)


def simplest(ranked: Sequence[ValidatedFit], scale: Scale) -> ValidatedFit:
    """The fewest parameters among those that the best does not stand before; of what noise cannot
    tell apart the physics of a balance before the path of an input.
    """
    lead = min(ranked, key=lambda rival: rival.cost)
    if scale.nats:
        near = [rival for rival in ranked if rival is lead or rival.cost < lead.cost + TIE]
    else:
        near = [
            rival
            for rival in ranked
            if rival is lead or rival.cost < 1.1 * lead.cost or _beside(rival, lead, scale)
        ]
    chosen = min(near, key=lambda rival: (rival.parameters, rival.cost))
    return _physics_first(chosen, ranked, scale) if scale.nats else chosen


def _physics_first(
    chosen: ValidatedFit, ranked: Sequence[ValidatedFit], scale: Scale
) -> ValidatedFit:
    """What is as likely as the chosen one, no rarer, and has a balance's effect in the place of one
    on an input.

    A power law of a heater and of the command that it follows are one equation: nothing but a
    parameter's price would choose.
    """
    least = chosen.cost - scale.price * chosen.parameters + TIE
    same = [
        rival
        for rival in ranked
        if rival.cost - scale.price * rival.parameters < least
        and rival.rarity <= chosen.rarity
        and len(rival.keys) == len(chosen.keys) == len({*rival.keys, *chosen.keys}) - 1
    ]
    return min([chosen, *same], key=lambda rival: (_on_inputs(rival), rival.parameters, rival.cost))


def _on_inputs(candidate: ValidatedFit) -> int:
    return sum(
        key.effect != HELD and find_effect(key.effect).place == "input" for key in candidate.keys
    )


def _beside(rival: ValidatedFit, lead: ValidatedFit, scale: Scale) -> bool:
    mean, std = paired(lead, rival, scale)
    return mean < std and rival.cost < 1.4 * lead.cost


def is_alike(
    rival: ValidatedFit, chosen: ValidatedFit, before: ValidatedFit | None, scale: Scale
) -> bool:
    """Whether the data cannot tell another structure from the chosen one, both in the place of
    `before`.
    """
    if not scale.nats:
        mean, std = paired(chosen, rival, scale)
        return mean <= 2.0 * std and rival.cost < 1.5 * chosen.cost
    # deletion has a scatter of its own: two structures that the seen blocks cannot tell apart are
    # alike, too, whatever it says of the unseen ones
    difference = 0.5 * (rival.power - chosen.power).sum(axis=1)
    doubt = float(difference.std(ddof=1) * np.sqrt(len(difference)))
    most = np.inf if before is None else 0.2 * (before.cost - chosen.cost)
    return min(rival.cost - chosen.cost, rival.seen_cost - chosen.seen_cost) < max(
        TIE, min(doubt, most)
    )


def all_alike(
    ranked: Sequence[ValidatedFit], chosen: ValidatedFit, before: ValidatedFit | None, scale: Scale
) -> list[ValidatedFit]:
    """Those that the data cannot tell from the chosen one, in the place of `before`."""
    return [
        rival for rival in ranked if rival is not chosen and is_alike(rival, chosen, before, scale)
    ]


def going_on(ranked: Sequence[ValidatedFit], scale: Scale) -> list[ValidatedFit]:
    """Those that a next effect is tried beside: ties have to travel."""
    lead = ranked[0]
    if scale.nats:
        return [rival for rival in ranked if rival.cost < lead.cost + TIE][:BEAM]
    near = [
        rival
        for rival in ranked
        if rival is lead or rival.cost < 1.2 * lead.cost or _within_three(rival, lead, scale)
    ]
    return near[:BEAM]


def _within_three(rival: ValidatedFit, lead: ValidatedFit, scale: Scale) -> bool:
    mean, std = paired(lead, rival, scale)
    return mean < 3.0 * std
