"""What the header of an array in NumPy's .npy form declares, before anything is allocated for
it.
"""

from __future__ import annotations

import io
from functools import lru_cache
from math import prod
from typing import Any, NamedTuple

import numpy as np

LONGEST_HEADER = 1024
"""Bytes of a header's text that are read at most."""
# Version 3 is for names of fields in UTF-8, which a plain array has not.
_READERS = {1: np.lib.format.read_array_header_1_0, 2: np.lib.format.read_array_header_2_0}


class NotNpy(ValueError):
    """Bytes do not begin as a plain array in .npy form does; the message says why."""


class LongHeader(NotNpy):
    """A header is longer than any plain array needs."""


class NpyHeader(NamedTuple):
    """What an array is declared to be; its samples begin at the byte `start`."""

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    fortran_order: bool
    start: int

    @property
    def size(self) -> int:
        """Bytes that the samples take."""
        return prod(self.shape) * self.dtype.itemsize


def npy_header(data: bytes | memoryview) -> NpyHeader:
    """The header at the begin of `data`, which need not hold all samples; read by NumPy (versions 1
    and 2).

    Whoever reads the samples holds `size` against the bytes that there are: a header from a
    stranger may declare any shape.

    Raises
    ------
    LongHeader
        More than a kilobyte of header.
    NotNpy
        Another kind of file, the end inside the header, or a header that NumPy does not read.

    Examples
    --------
    >>> file = io.BytesIO(); np.save(file, np.zeros((3, 4), dtype="<f4"))
    >>> header = npy_header(file.getvalue())
    >>> header.shape, header.size, header.start
    ((3, 4), 48, 128)
    """
    if bytes(data[:6]) != np.lib.format.MAGIC_PREFIX or len(data) < 12:
        raise NotNpy(
            f"is not an .npy array (it begins with {bytes(data[:6])!r}); numpy.save writes one"
        )
    # magic 6 bytes, version 2, then the header's length in 2 bytes, from version 2 on in 4
    start = 12 if data[6] >= 2 else 10
    length = int.from_bytes(data[8:start], "little")
    if length > LONGEST_HEADER:
        raise LongHeader(f".npy header of {length} bytes; at most {LONGEST_HEADER} are read")
    if len(data) < start + length:
        raise NotNpy("ends inside the .npy header")
    return _parsed(bytes(data[: start + length]))


@lru_cache(maxsize=256)
def _parsed(head: bytes) -> NpyHeader:
    """What a whole header says; remembered, since a client sends the same one again and again."""
    stream = io.BytesIO(head)
    try:
        shape, fortran_order, dtype = _READERS[np.lib.format.read_magic(stream)[0]](stream)
    # what a stranger's text makes of the parser has no list: SyntaxError, RecursionError, TypeError
    # …
    except Exception as error:
        raise NotNpy(f".npy header {head[10:90]!r}: only plain arrays are read") from error
    # NumPy reads a negative length, of which the product of two would pass for a size.
    if min(shape, default=0) < 0:
        raise NotNpy(
            f".npy header {head[10:90]!r}: only plain arrays are read, and no shape is negative"
        )
    return NpyHeader(dtype, tuple(map(int, shape)), fortran_order, len(head))
