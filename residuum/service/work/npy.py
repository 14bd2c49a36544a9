"""Arrays in NumPy's .npy form, from a stranger: every size is checked before anything is
allocated.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from residuum.identification.npy_header import LongHeader, NotNpy, NpyHeader, npy_header
from residuum.service.body_errors import BadBody, TooLarge


def read_npy(body: bytes | memoryview, subject: str = "body") -> npt.NDArray[Any]:
    """The array of an .npy body (format versions 1 and 2), without a copy.

    Plain integer and floating types only, one or two dimensions. The shape that the header declares
    must be that of the bytes that follow, so a header cannot make the service allocate more than
    was sent.

    Raises
    ------
    BadBody
        No .npy, another type (object arrays are never read), a shape that differs from the bytes,
        no sample.
    TooLarge
        A header of more than a kilobyte.

    Examples
    --------
    >>> import io
    >>> file = io.BytesIO(); np.save(file, np.arange(3.0))
    >>> read_npy(file.getvalue()).tolist()
    [0.0, 1.0, 2.0]
    """
    header = read_header(body, subject)
    dtype, shape, received = header.dtype, header.shape, len(body) - header.start
    if dtype.kind not in "fiu" or dtype.itemsize > 8:
        raise BadBody(
            f"{subject}: .npy type {str(dtype)[:80]}: only plain integer and floating arrays are"
            f" read; {_way_on(dtype)}"
        )
    if not 1 <= len(shape) <= 2 or not header.size:
        raise BadBody(
            f"{subject}: .npy shape {shape}: must have one or two dimensions and hold samples"
        )
    # equal, not enough: what is left over says that shape or type is another than was meant
    if header.size != received:
        raise BadBody(
            f"{subject}: .npy shape {shape} of {dtype.str} needs {header.size} bytes; {received}"
            " came"
        )
    return np.frombuffer(body, dtype=dtype, offset=header.start).reshape(
        shape, order="F" if header.fortran_order else "C"
    )


def _way_on(dtype: np.dtype[Any]) -> str:
    return "send its real part, array.real" if dtype.kind == "c" else "send array.astype('f8')"


def read_header(data: bytes | memoryview, subject: str) -> NpyHeader:
    """The header at the begin of `data`; BadBody or TooLarge as of `subject`."""
    try:
        return npy_header(data)
    except LongHeader as error:
        raise TooLarge(f"{subject}: {error}") from None
    except NotNpy as error:
        raise BadBody(f"{subject}: {error}") from None
