"""Which channels of a polled device look wrong: another order of words is far likelier, or what stands there means no value."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from residuum.service.fieldbus.modbus.device_reading import MISSING, ChannelReading

_JUDGED = 10
"""[samples] That are looked at before anything is said."""
_OFTEN = 0.3
"""Part of them that has to look wrong: now and then a register may well hold such a number."""
_OUTLASTS = 10
"""Judgements that a doubt outlasts: a sensor that is there now and then must not turn its channel good in between."""


class DoubtfulChannels:
    """Readings of one stream counted; `sentences` says what looks wrong, or did lately."""

    def __init__(self) -> None:
        self.sentences: list[str] = []
        self._samples = 0
        self._wrong: Counter[str] = Counter()
        self._remarks: Counter[tuple[str, str]] = Counter()
        self._says: dict[str, tuple[str, int]] = {}

    def look(self, readings: Iterable[ChannelReading]) -> None:
        """Count one sample's readings."""
        self._samples += 1
        for reading in readings:
            if reading.remark not in ("", MISSING):
                self._wrong[reading.channel] += 1
                self._remarks[reading.channel, f"{reading.stream}.{reading.channel}: {reading.remark}"] += 1
        if self._samples % _JUDGED == 0:
            self._judge()

    def _judge(self) -> None:
        """Say of each channel that often looks wrong what is most often said of it, and forget what has long been right."""
        now: dict[str, tuple[str, int]] = {}
        for (channel, sentence), _ in self._remarks.most_common():
            if self._wrong[channel] >= _OFTEN * _JUDGED:
                now.setdefault(channel, (sentence, self._samples + _OUTLASTS * _JUDGED))
        lately = {channel: said for channel, said in self._says.items() if said[1] > self._samples}
        self._says = lately | now
        self.sentences = [sentence for sentence, _ in self._says.values()]
        self._wrong, self._remarks = Counter(), Counter()
