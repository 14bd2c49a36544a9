"""Visibility: how large an effect that was not found would have had to be, to be seen in this experiment."""

from __future__ import annotations

import numpy as np

from residuum.identification.discrepancy.policy.acceptance import ACCEPT
from residuum.identification.discrepancy.searching.search_state import Search
from residuum.identification.physics.model import find_effect
from residuum.identification.unseen_blocks.advice import Undetectable


def undetectable(found: Search) -> tuple[Undetectable, ...]:
    """For every screened effect with a size that was not accepted.

    The information I on the size, free parameters and initial states projected out and noise whitened, makes a size s worth
    ½·I·s² of log-likelihood; it must exceed what acceptance asks for.
    """
    listed = []
    for (id, target), screened in found.screened.items():
        effect = find_effect(id)
        if (id, target) in found.accepted or not effect.sizes or not screened.information > 0:
            continue
        name = effect.sizes[0]
        label = screened.start.effects[-1].label
        price = 0.5 * np.log(found.base.samples) * screened.own_parameters
        needed = float(np.log(max(found.count, 1)) + ACCEPT + price)
        unit = screened.start.all_parameters[f"{label}.{name}"].unit
        size = float(np.sqrt(2.0 * needed / screened.information))
        listed.append(Undetectable(id, target, {name: size}, unit))
    return tuple(listed)
