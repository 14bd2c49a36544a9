"""Packets: messages of SAE J1939 that no frame holds, put together from those of its transport
protocol.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

from residuum.service.fieldbus.can.frame_batch import EXTENDED, FrameBatchBuilder
from residuum.service.fieldbus.can.frame_layout import FrameLayout, group_of, source_of
from residuum.service.fieldbus.can.frame_matching import FrameMatching

# SAE J1939-21, 5.10: the groups of what is said of a message before and of its packets.
_ANNOUNCED, _PACKET = 0xEC00, 0xEB00
# What an announcement is: to one device, which may ask for a packet again; to all; given up.
_TO_ONE, _TO_ALL, _GIVEN_UP = 16, 32, 255
# Bytes: a packet's first one is its number, from 1 on.
_IN_A_PACKET = 7


@dataclass
class _Coming:
    """A message whose packets come."""

    layout: FrameLayout
    identifier: int
    size: int
    to_all: bool
    packets: dict[int, bytes | bytearray] = field(default_factory=dict)

    @property
    def whole(self) -> bytes | None:
        """Its bytes, those of its layout: a newer device may send more, and what an older one does
        not send is not available; None while packets are to come.
        """
        last = -(-self.size // _IN_A_PACKET)
        if len(self.packets) < last:
            return None
        sent = b"".join(self.packets[number] for number in range(1, last + 1))[: self.size]
        return sent[: self.layout.length].ljust(self.layout.length, b"\xff")


class Packets:
    """Puts together the messages of more than eight bytes of a DBC file, of one bus.

    A message of which a packet was lost is given up: its value is missing, never mixed from two.

    Parameters
    ----------
    layouts : iterable of FrameLayout

    Examples
    --------
    >>> from residuum.service.fieldbus.can.frame_layout import BusMessages
    >>> Packets(BusMessages().values()).put(EXTENDED | 0x18EBFF03, bytes(8)) is None
    True
    """

    def __init__(self, layouts: Iterable[FrameLayout]) -> None:
        self._known = FrameMatching(layout for layout in layouts if layout.in_packets)
        # one message at a time from a device to another, or to all
        self._coming: dict[int, _Coming] = {}
        self._given_up: Counter[str] = Counter()

    def put(self, identifier: int, data: bytes | bytearray) -> tuple[int, bytes] | None:
        """Take one frame; the identifier of a message and its bytes where it is the last packet."""
        if identifier >> 16 & 0xFF not in (_ANNOUNCED >> 8, _PACKET >> 8) or len(data) != 8:
            return None
        group, devices = group_of(identifier), identifier & 0xFFFF
        if group == _ANNOUNCED:
            self._announce(identifier, devices, data)
        elif group == _PACKET and devices in self._coming:
            return self._add(devices, data[0], data[1:])
        return None

    def is_known(self, identifier: int, data: bytes | bytearray) -> bool:
        """Whether a frame, before it is put, is of a message that is put together."""
        announced = self._announced(identifier, data)
        if announced is not None:
            return self._known.get(announced) is not None
        return group_of(identifier) == _PACKET and identifier & 0xFFFF in self._coming

    def given_up(self) -> list[tuple[str, int]]:
        """Messages of which packets were missing, and how often since this was last asked."""
        given_up, self._given_up = list(self._given_up.items()), Counter()
        return given_up

    def _announced(self, identifier: int, data: bytes | bytearray) -> int | None:
        """The identifier that a frame would have which held the announced message whole."""
        if group_of(identifier) != _ANNOUNCED or len(data) != 8 or not identifier & EXTENDED:
            return None
        if data[0] not in (_TO_ONE, _TO_ALL):
            return None
        group = int.from_bytes(data[5:8], "little")
        return EXTENDED | identifier & 7 << 26 | group << 8 | source_of(identifier)

    def _announce(self, identifier: int, devices: int, data: bytes | bytearray) -> None:
        announced = self._announced(identifier, data)
        if announced is None and data[0] != _GIVEN_UP:
            return
        self._give_up(devices)
        layout = None if announced is None else self._known.get(announced)
        size = int.from_bytes(data[1:3], "little")
        if layout is not None and announced is not None and size > 8:
            self._coming[devices] = _Coming(layout, announced, size, data[0] == _TO_ALL)

    def _add(self, devices: int, number: int, data: bytes | bytearray) -> tuple[int, bytes] | None:
        coming = self._coming[devices]
        # to all nothing is sent again: what comes out of turn is of a message not heard announced
        if coming.to_all and number != len(coming.packets) + 1:
            self._give_up(devices)
            return None
        coming.packets[number] = data
        whole = coming.whole
        if whole is None:
            return None
        del self._coming[devices]
        return coming.identifier, whole

    def _give_up(self, devices: int) -> None:
        if coming := self._coming.pop(devices, None):
            self._given_up[coming.layout.name] += 1


@dataclass
class WholeMessages(FrameBatchBuilder):
    """Collects frames, and the messages that `packets` puts together from them."""

    packets: Packets = field(default_factory=lambda: Packets(()))

    def put(self, identifier: int, data: bytes | bytearray) -> None:
        """The bytes of one data frame, and of a message of which it is the last packet."""
        super().put(identifier, data)
        if whole := self.packets.put(identifier, data):
            super().put(*whole)
