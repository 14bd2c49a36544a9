"""Which message a frame is of: by its identifier; a message of SAE J1939 by its parameter group,
whatever priority, destination and, unless the DBC file names one, source address the frame has.
"""

from __future__ import annotations

from collections.abc import Iterable

from residuum.service.fieldbus.can.frame_batch import EXTENDED
from residuum.service.fieldbus.can.frame_layout import FrameLayout, group_of, source_of


class FrameMatching:
    """The messages of a DBC file, asked by the identifiers of frames (with `EXTENDED`).

    Parameters
    ----------
    layouts : iterable of FrameLayout
    """

    def __init__(self, layouts: Iterable[FrameLayout]) -> None:
        self._exact: dict[int, FrameLayout] = {}
        self._groups: dict[tuple[int, int | None], FrameLayout] = {}
        for layout in layouts:
            if layout.is_j1939:
                self._groups[group_of(layout.frame_id), layout.source_address] = layout
            else:
                self._exact[layout.bus_id] = layout

    def get(self, identifier: int) -> FrameLayout | None:
        """The message of a frame; None for one of no message."""
        if identifier in self._exact or not identifier & EXTENDED or not self._groups:
            return self._exact.get(identifier)
        group = group_of(identifier)
        named = self._groups.get((group, source_of(identifier)))
        return self._groups.get((group, None)) if named is None else named

    def sender(self, identifier: int) -> int:
        """What frames of one message and one device have in common: the identifier, of J1939
        without priority and destination.
        """
        layout = self.get(identifier)
        if layout is None or not layout.is_j1939:
            return identifier
        return EXTENDED | group_of(identifier) << 8 | source_of(identifier)


def several_sources(layout: FrameLayout, sources: Iterable[int]) -> str:
    """What is said of a message that comes from several devices."""
    return (
        f"message {layout.name}: comes from the source addresses"
        f" {', '.join(f'0x{source:02X}' for source in sorted(sources))}, and which is meant is not"
        " guessed; give it the attribute SourceAddress"
    )
