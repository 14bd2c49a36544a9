"""What is usual comes first among equals: a rare effect has to earn more than one that machines of this kind often lack."""

from __future__ import annotations

from residuum.identification.physics import Key, PhysicalModel
from residuum.identification.physics.effects import EFFECTS, STRUCTURAL
from residuum.identification.physics.effects.how_often import share_lacking
from residuum.identification.physics.model import place_of
from residuum.identification.unseen_blocks.policy import OCCASIONAL, RARE, USUAL_SHARE


def rarity(model: PhysicalModel, key: Key) -> float:
    """For how many parameters the effect counts besides its own: none where machines of the kind of its balance often lack it.

    On the path of an input or output the kinds of all balances count. A user's own effect counts for none, nor does a value that
    the model holds.
    """
    if key.effect not in (EFFECTS.keys() | STRUCTURAL.keys()) or EFFECTS.fingerprint(key.effect):
        return 0.0
    place = model.balances.get(place_of(key.target))
    share = share_lacking(key.effect, [b.kind for b in model.balances.values()] if place is None else [place.kind])
    if share is None or share >= USUAL_SHARE:
        return 0.0
    return OCCASIONAL if share > 0.0 else RARE
