"""Multiplexing: which signals of a CAN message a frame carries, by the page that its multiplexer signals name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from residuum.service.fieldbus.block import Samples


class Multiplexing:
    """Pages of a message, cascaded ones too (a multiplexer that is itself on a page).

    Parameters
    ----------
    signals : sequence of cantools signals
    """

    def __init__(self, signals: Sequence[Any]) -> None:
        place = {signal.name: k for k, signal in enumerate(signals)}
        paged = [signal for signal in signals if signal.multiplexer_ids is not None and signal.multiplexer_signal in place]
        parent = {place[signal.name]: place[signal.multiplexer_signal] for signal in paged}
        self._pages = sorted(
            ((place[signal.name], parent[place[signal.name]], np.array(signal.multiplexer_ids, float)) for signal in paged),
            key=lambda page: _depth(page[0], parent),
        )
        self.paged = frozenset(parent)
        """Places of the signals that not every frame carries."""

    def carried(self, values: Samples) -> npt.NDArray[np.bool_]:
        """Which of the values, shape (n, signals), their frames carry."""
        carried = np.ones(values.shape, bool)
        for k, multiplexer, pages in self._pages:
            carried[:, k] = carried[:, multiplexer] & np.isin(np.trunc(values[:, multiplexer]), pages)
        return carried


def _depth(signal: int, parent: dict[int, int]) -> int:
    """How many multiplexers stand above a signal; one that is above itself is as deep as there are signals."""
    depth = 0
    while signal in parent and depth <= len(parent):
        signal, depth = parent[signal], depth + 1
    return depth
