"""Raw numbers of a CAN signal that say that there is no value: not available, error, reserved.

SAE J1939-71 (extended frames) keeps the top of every number's range for them: from 0xFB, 0xFB00, 0xFB000000 on, binary 10 and
11 of two bits, 0xE and 0xF of four. Other buses send all ones, or the ends of a signed number. Whatever the scaling, such a
number is one only if its value lies outside of the range that the DBC file declares; where the file calls a message J1939's and
declares no range it always is. A value table may name one.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

_NAMED = re.compile(r"(?i)\b(sna|n/a|not avail\w*|unavailable|no value|signal invalid|invalid signal)\b")
_J1939 = "j1939"


class NoValueCodes:
    """Which raw numbers of a message's signals mean no value.

    Parameters
    ----------
    message : cantools message
    """

    def __init__(self, message: Any) -> None:
        j1939, extended = message.protocol == _J1939, bool(message.is_extended_frame)
        pages = {signal.multiplexer_signal for signal in message.signals}
        self._spans = [
            (k, np.uint64(first), np.uint64(last))
            for k, signal in enumerate(message.signals)
            if signal.name not in pages and not signal.conversion.is_float
            for first, last in [*_reserved(signal, j1939, extended), *_named(signal)]
        ]

    def there(self, raw: npt.NDArray[np.uint64]) -> npt.NDArray[np.bool_]:
        """Where a raw number, shape (n, signals), is one of them."""
        found = np.zeros(raw.shape, bool)
        for k, first, last in self._spans:
            found[:, k] |= (raw[:, k] >= first) & (raw[:, k] <= last)
        return found


def _named(signal: Any) -> list[tuple[int, int]]:
    ones = (1 << signal.length) - 1
    return [
        (int(raw) & ones, int(raw) & ones)
        for raw, text in (signal.choices or {}).items()
        if _NAMED.search(str(text).replace("_", " "))
    ]


def _reserved(signal: Any, j1939: bool, extended: bool) -> Sequence[tuple[int, int]]:
    """(first, last) raw numbers, as bits, at the ends of a signal's range."""
    bits = signal.length
    ones, sign = (1 << bits) - 1, 1 << (bits - 1)
    if signal.is_signed:
        ends = [(sign, -sign), (sign - 1, sign - 1)] if bits >= 8 else []
        return [(raw, raw) for raw, number in ends if _declared(signal, number) is False]
    first = _first_reserved(bits) if extended else ones if bits >= 8 else None
    if first is None:
        return []
    within = _declared(signal, first)
    return [(first, ones)] if within is False or (j1939 and within is None) else []


def _first_reserved(bits: int) -> int | None:
    if bits >= 8:
        return 0xFB << (bits - 8)
    return {2: 0b10, 4: 0xE}.get(bits)


def _declared(signal: Any, number: int) -> bool | None:
    """Whether a raw number's value lies within the range that the file declares; None where it declares none."""
    low, high = signal.minimum, signal.maximum
    if low is None or high is None or not low < high:
        return None
    value = number * signal.conversion.scale + signal.conversion.offset
    slack = 0.5 * abs(signal.conversion.scale)
    return bool(low - slack <= value <= high + slack)
