"""SignalBits: where the signals of a CAN message lie in its frames; raw numbers and physical values of many frames at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from residuum.service.fieldbus.block import Samples

Bytes = npt.NDArray[np.uint8]
Raw = npt.NDArray[np.uint64]
MOST_BITS = 64
_FLOATS: dict[int, tuple[Any, Any]] = {16: (np.float16, np.uint16), 32: (np.float32, np.uint32), 64: (np.float64, np.uint64)}
"""Bits of a floating-point signal → its type, and the whole number of the same bits."""
_ALL_ONES = np.uint64(0xFFFFFFFFFFFFFFFF)


class SignalBits:
    """Bit positions, signs and scales of signals of at most 64 bits.

    Parameters
    ----------
    signals : sequence of cantools signals
    """

    def __init__(self, signals: Sequence[Any]) -> None:
        spans = [_span(signal.start, signal.length, signal.byte_order) for signal in signals]
        shape = (len(signals), max((len(order) for order, _ in spans), default=0))
        self._bits = np.array([signal.length for signal in signals], np.uint64)
        self._index, self._there = np.zeros(shape, np.intp), np.zeros(shape, bool)
        self._left, self._right = np.zeros(shape, np.uint64), np.zeros(shape, np.uint64)
        for k, (order, lowest) in enumerate(spans):
            for j, byte in enumerate(reversed(order)):
                self._index[k, j], self._there[k, j] = byte, True
                self._left[k, j], self._right[k, j] = max(8 * j - lowest, 0), max(lowest - 8 * j, 0)
        self._mask = _ALL_ONES >> (np.uint64(MOST_BITS) - self._bits)
        self._signed = np.array([signal.is_signed for signal in signals], bool)
        self._floats = [(k, signal.length) for k, signal in enumerate(signals) if signal.conversion.is_float]
        self._scale = np.array([float(signal.conversion.scale) for signal in signals])
        self._offset = np.array([float(signal.conversion.offset) for signal in signals])

    def raw(self, frames: Bytes) -> Raw:
        """The bits of each signal as a number, shape (n, signals), from frames of shape (n, length)."""
        parts = (frames[:, self._index].astype(np.uint64) * self._there) << self._left >> self._right
        whole: Raw = np.bitwise_or.reduce(parts, axis=2) & self._mask
        return whole

    def values(self, raw: Raw) -> Samples:
        """Physical values of raw numbers, shape (n, signals)."""
        sign = np.uint64(1) << (self._bits - np.uint64(1))
        signed = (raw ^ sign).astype(np.int64) - sign.astype(np.int64)
        values = np.where(self._signed, signed.astype(float), raw.astype(float)) * self._scale + self._offset
        for k, bits in self._floats:
            kind, integer = _FLOATS[bits]
            with np.errstate(invalid="ignore"):  # NaN is missing, also a signalling one
                values[:, k] = raw[:, k].astype(integer).view(kind).astype(float) * self._scale[k] + self._offset[k]
        return values

    def raw_of(self, values: Samples) -> Raw:
        """Raw numbers of physical values, shape (n, signals), rounded and clipped to what fits; missing ones as 0."""
        scaled = np.nan_to_num((values - self._offset) / self._scale)
        bits = self._bits.astype(float)
        # the largest float below 2⁶⁴ (2⁶³): the limit itself is no 64-bit number
        high = np.minimum(2.0**bits - 1, np.nextafter(2.0**64, 0))
        highest = np.minimum(2.0 ** (bits - 1) - 1, np.nextafter(2.0**63, 0))
        unsigned = np.clip(np.rint(np.where(self._signed, 0.0, scaled)), 0.0, high).astype(np.uint64)
        signed = np.clip(np.rint(np.where(self._signed, scaled, 0.0)), -(2.0 ** (bits - 1)), highest).astype(np.int64)
        raw: Raw = np.where(self._signed, signed.astype(np.uint64), unsigned)
        for k, width in self._floats:
            kind, integer = _FLOATS[width]
            raw[:, k] = ((values[:, k] - self._offset[k]) / self._scale[k]).astype(kind).view(integer).astype(np.uint64)
        return raw

    def frames(self, raw: Raw, length: int) -> Bytes:
        """Frames, shape (n, length), that carry these raw numbers."""
        frames = np.zeros((length, len(raw)), np.uint8)
        masked = raw & self._mask
        for j in range(self._index.shape[1]):
            byte = ((masked >> self._left[:, j] << self._right[:, j]) & np.uint64(0xFF)) * self._there[:, j]
            np.bitwise_or.at(frames, self._index[:, j], byte.T.astype(np.uint8))
        return np.ascontiguousarray(frames.T)


def usable_bits(signal: Any) -> bool:
    """Whether a signal is of a width that is read here: at most 64 bits, a floating-point one 16, 32 or 64."""
    return signal.length in _FLOATS if signal.conversion.is_float else signal.length <= MOST_BITS


def _span(start: int, length: int, byte_order: str) -> tuple[list[int], int]:
    """Bytes that a signal touches, most significant first, and how far its lowest bit is from the end of the last one."""
    if byte_order == "little_endian":
        first, last = start // 8, (start + length - 1) // 8
        return list(range(last, first - 1, -1)), start - 8 * first
    begin = 8 * (start // 8) + 7 - start % 8
    first, last = begin // 8, (begin + length - 1) // 8
    return list(range(first, last + 1)), 8 * (last + 1) - (begin + length)
