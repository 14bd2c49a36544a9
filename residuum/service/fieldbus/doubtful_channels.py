"""Which channels of a polled device look wrong: another order of words is far likelier, or what stands there means no value."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from residuum.service.fieldbus.device_reading import MISSING, ChannelReading

_JUDGED = 10
"""[samples] That are looked at before anything is said."""
_OFTEN = 0.3
"""Part of them that has to look wrong: now and then a register may well hold such a number."""


class DoubtfulChannels:
    """Readings of one stream counted; `sentences` says what looks wrong in the last samples that were judged together."""

    def __init__(self) -> None:
        self.sentences: list[str] = []
        self._samples = 0
        self._wrong: Counter[str] = Counter()
        self._says: dict[str, str] = {}

    def look(self, readings: Iterable[ChannelReading]) -> None:
        """Count one sample's readings."""
        self._samples += 1
        for reading in readings:
            if reading.remark not in ("", MISSING):
                self._wrong[reading.channel] += 1
                self._says[reading.channel] = f"{reading.stream}.{reading.channel}: {reading.remark}"
        if self._samples == _JUDGED:
            self.sentences = [self._says[name] for name, times in self._wrong.items() if times >= _OFTEN * _JUDGED]
            self._samples, self._wrong = 0, Counter()
