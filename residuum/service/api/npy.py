"""Arrays in NumPy's .npy form, from a stranger: header parsed by hand, every size checked before anything is allocated."""

from __future__ import annotations

import re
from functools import lru_cache
from math import prod
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from residuum.service.problems import BadBody, TooLarge

_MAGIC = b"\x93NUMPY"
_LONGEST_HEADER = 1024
_HEADER = re.compile(
    r"\{\s*'descr':\s*'(?P<dtype>[<>|=]?[fiu][1248])',\s*'fortran_order':\s*(?P<fortran>True|False),"
    r"\s*'shape':\s*\((?P<shape>[0-9, ]{0,60})\),?\s*\}\s*"
)


def read_npy(body: bytes | memoryview, what: str = "body") -> npt.NDArray[Any]:
    """The array of an .npy body (format versions 1 and 2), without a copy.

    Plain integer and floating types only, one or two dimensions. The shape that the header declares must be that of the
    bytes that follow, so a header cannot make the service allocate more than was sent.

    Raises
    ------
    BadBody
        No .npy, another type (object arrays are never read), a shape that differs from the bytes, no sample.
    TooLarge
        A header of more than a kilobyte.

    Examples
    --------
    >>> import io
    >>> file = io.BytesIO(); np.save(file, np.arange(3.0))
    >>> read_npy(file.getvalue()).tolist()
    [0.0, 1.0, 2.0]
    """
    start, header = _header(body, what)
    if (layout := _layout(header)) is None:
        raise BadBody(f"{what}: .npy header {header[:80]!r}: only plain integer and floating arrays are read")
    dtype, shape, order, needed = layout
    if not 1 <= len(shape) <= 2 or not needed:
        raise BadBody(f"{what}: .npy shape {shape}: must have one or two dimensions and hold samples")
    if needed != len(body) - start:
        raise BadBody(f"{what}: .npy shape {shape} of {dtype.str} needs {needed} bytes; {len(body) - start} came")
    return np.frombuffer(body, dtype=dtype, offset=start).reshape(shape, order=order)


class _Layout(NamedTuple):
    """What an .npy header declares; `size` is that of the samples [bytes]."""

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    order: Literal["C", "F"]
    size: int


@lru_cache(maxsize=256)
def _layout(header: str) -> _Layout | None:
    """What a header declares, None when it is of another kind; remembered, since a client sends the same one again and again."""
    if (match := _HEADER.fullmatch(header)) is None:
        return None
    shape = tuple(int(size) for size in match["shape"].replace(" ", "").split(",") if size)
    dtype = np.dtype(match["dtype"])
    return _Layout(dtype, shape, "F" if match["fortran"] == "True" else "C", prod(shape) * dtype.itemsize)


def _header(body: bytes | memoryview, what: str) -> tuple[int, str]:
    """(where the samples start, the header's text)."""
    if bytes(body[:6]) != _MAGIC or len(body) < 12:
        raise BadBody(f"{what}: is not an .npy array (it begins with {bytes(body[:6])!r})")
    wide = body[6] >= 2
    start = 12 if wide else 10
    length = int.from_bytes(body[8:start], "little")
    if length > _LONGEST_HEADER:
        raise TooLarge(f"{what}: .npy header of {length} bytes; at most {_LONGEST_HEADER} are read")
    if len(body) < start + length:
        raise BadBody(f"{what}: ends inside the .npy header")
    return start + length, bytes(body[start : start + length]).decode("latin-1")
