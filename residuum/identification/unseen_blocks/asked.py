"""Effects that a user asks for: each joins the model, real or not, from where it promises most."""

from __future__ import annotations

from collections.abc import Sequence

from residuum.identification.errors import NotIdentifiable
from residuum.identification.physics import Key
from residuum.identification.unseen_blocks.data import Data
from residuum.identification.unseen_blocks.following import followed
from residuum.identification.unseen_blocks.judged import Judged
from residuum.identification.unseen_blocks.ladder import climb, climb_at_likelier_timing
from residuum.identification.unseen_blocks.looks import followed_on, glance, look
from residuum.identification.unseen_blocks.search import settled
from residuum.identification.unseen_blocks.settling import at_the_timing_it_suits, begun
from residuum.identification.unseen_blocks.structure import Structure
from residuum.identification.unseen_blocks.tried import Search
from residuum.identification.work import Tell, untold

_OTHERWISE = "start from other values, or leave it out"


def with_asked(
    data: Data, keys: Sequence[Key], tell: Tell = untold, *, turn: bool = True
) -> Search:
    """The data's model with these effects, one after the other, at the likelier input timing where
    it may be turned.

    Raises
    ------
    NotIdentifiable
        The model diverges on the records, as it is or with one of the effects.
    """
    tell(0.0, "estimating the model as it is")
    search = begun(climb_at_likelier_timing(data) if turn else climb(data))
    for number, key in enumerate(keys):
        tell(0.1 + 0.8 * number / len(keys), f"adding {key.effect} to {key.target}")
        after = _joined(search, key)
        if after is None:
            raise NotIdentifiable(
                f"effect {key.effect!r} at {key.target!r}: the model diverges with it; {_OTHERWISE}"
            )
        search.best, search.every[after.keys] = after, after
        if turn and (retimed := at_the_timing_it_suits(search)) is not None:
            return with_asked(retimed, keys, tell, turn=False)
        settled(search, [after])
    return search


def _joined(search: Search, key: Key) -> Judged | None:
    """The best structure with one effect more; None where it diverges from all first values."""
    parent, court = search.best, search.court
    along = followed(parent.model, court.data, parent.errors, court.last)
    if along is None:
        return None
    given = None if parent.keys else followed(court.data.model, court.data)
    glanced = glance(parent.structure, key, along, court, given)
    if glanced is None:
        return None
    near = followed_on(glanced)
    lowest = min((fits[0] for fits in near.seen.values()), key=lambda fit: fit.mean)
    structure = Structure(near.keys, lowest.model, parent.structure.states, parent.structure.steps)
    return look(near, court) or court.judge(structure, steps=15, tolerance=1e-5)
