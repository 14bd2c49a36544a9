"""The first rows as read, by which a person sees whether a file was understood."""

import numpy as np

from residuum.identification.record_formats.even_time import FloatArray

_SHOWN = 3


def first_rows(time: FloatArray, channels: FloatArray) -> list[list[float | None]]:
    """Time and values of the first three samples of channels, shape (c, n); None for what is
    missing.
    """
    rows = np.column_stack([time[:_SHOWN], *(channel[:_SHOWN] for channel in channels)])
    return [[None if np.isnan(value) else float(value) for value in row] for row in rows]
