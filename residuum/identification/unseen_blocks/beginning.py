"""Where a search begins: the model as it is, judged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from residuum.identification.errors import MAY_DIVERGE, NotIdentifiable
from residuum.identification.unseen_blocks.judged import judged
from residuum.identification.unseen_blocks.ladder import Climbed
from residuum.identification.unseen_blocks.looks import Court
from residuum.identification.unseen_blocks.scale import of_power
from residuum.identification.unseen_blocks.settling import settle
from residuum.identification.unseen_blocks.tried import Search


def begun(climbed: Climbed) -> Search:
    """The model as it is, judged; in nats where all it leaves is noise."""
    data, last = climbed.data, climbed.last
    first = judged(climbed.structure, climbed.found, last, data, climbed.scale)
    if first is None:
        raise NotIdentifiable(f"model {data.model.name!r}: diverges on the records; {MAY_DIVERGE}")
    scale = of_power(climbed.scale, data, first.power)
    first = replace(first, cost=scale.cost(first.power, first.parameters), seen=np.inf)
    court = Court(data, last, climbed.middle, scale, climbed.there)
    if (turned := settle(first, court)) is not None:
        court, first = turned
    return Search(court, first, first, None, {(): first})
