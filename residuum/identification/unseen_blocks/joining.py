"""Whether an effect joins what was found, and what it makes needless: forward selection, floating back after every step."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from residuum.identification.physics import Key
from residuum.identification.unseen_blocks.comparing import corrected, is_alike, is_real, real_ones, simplest
from residuum.identification.unseen_blocks.judged import Judged
from residuum.identification.unseen_blocks.policy import TIE, TWICE
from residuum.identification.unseen_blocks.settling import settle
from residuum.identification.unseen_blocks.tried import Search, with_only


def joins(found: Search, ranked: Sequence[Judged]) -> bool:
    """Whether any is real; the simplest of the best that are is the best from now on."""
    scale, before = found.court.scale, found.best
    real = real_ones(ranked, before, found.base, scale, found.tried) or _leaving_noise(found, ranked)
    if not real:
        return False
    found.best = chosen = simplest(real, scale)
    found.group = [one for one in ranked if one is not chosen and is_alike(one, chosen, before, scale)]
    return True


def _leaving_noise(found: Search, ranked: Sequence[Judged]) -> list[Judged]:
    """The simplest of the best, where it leaves nothing but noise and is real in nats of that: what acts seldom, a limit that is
    rarely met, is ahead in few blocks alone.
    """
    chosen = None if found.court.scale.nats else simplest(ranked, found.court.scale)
    if chosen is None or chosen.cost >= found.best.cost or (turned := settle(chosen, found.court)) is None:
        return []
    court, here = turned
    before = court.judge(found.best.structure, steps=15, tolerance=1e-6)
    if before is None or before.cost - here.cost < np.log(max(found.tried, 1)) + TIE or corrected(here, before) < TWICE:
        return []
    return [chosen]


def without_needless(found: Search) -> None:
    """Take effects from the best structure that are not real beside the others: what joined first may have stood for what
    joined after it, and led that astray.
    """
    for key in found.best.keys:
        best = found.best
        less = _without(found, key) if len(best.keys) > 1 else None
        if less is not None and not is_real(best, less, found.base, found.court.scale, found.tried):
            found.best, found.group = less, []


def _without(found: Search, key: Key) -> Judged | None:
    """The best structure without one effect, from its own values on or as it was known, whichever leaves less."""
    keys = tuple(k for k in found.best.keys if k != key)
    known = found.every.pop(keys, None)
    there = [one for one in (known, with_only(found, keys)) if one is not None]
    if not there:
        return None
    found.every[keys] = min(there, key=lambda one: one.cost)
    return found.every[keys]
