"""FrameSender: puts the samples of one stream into CAN frames, counter and all, and onto the bus."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from residuum.service.fieldbus.can.can_bus import CanBus
from residuum.service.fieldbus.can.frame_layout import Bytes, FrameLayout


class FrameSender:
    """Frames of one message from samples that come in pieces of any length.

    Parameters
    ----------
    layout : FrameLayout
    """

    def __init__(self, layout: FrameLayout) -> None:
        self.layout = layout
        self._sent = 0
        self._waiting: dict[str, npt.NDArray[np.float64]] = {
            name: np.empty(0) for name in layout.units
        }

    def frames(self, channels: Mapping[str, npt.NDArray[np.float64]]) -> Bytes:
        """The frames that these samples complete, shape (n, length)."""
        waiting = {
            name: np.concatenate([held, channels[name]]) for name, held in self._waiting.items()
        }
        n = len(next(iter(waiting.values()))) // self.layout.samples
        whole = n * self.layout.samples
        self._waiting = {name: values[whole:] for name, values in waiting.items()}
        counter = (self._sent + np.arange(n)) % (1 << self.layout.counter_bits)
        self._sent += n
        return self.layout.encode(
            counter, {name: values[:whole] for name, values in waiting.items()}
        )

    def send(self, bus: CanBus, channels: Mapping[str, npt.NDArray[np.float64]]) -> None:
        """Send the frames that these samples complete."""
        bus.send_many(self.layout.bus_id, self.frames(channels), is_fd=self.layout.is_fd)
