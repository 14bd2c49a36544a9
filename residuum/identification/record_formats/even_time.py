"""Sample time of a time column: even to 1 % of the step, or resampled on request."""

import numpy as np
import numpy.typing as npt

from residuum.identification.errors import BadRecord

FloatArray = npt.NDArray[np.float64]
JITTER = 0.01  # of the step


def even_columns(columns: FloatArray, source: str, *, resample: bool, first_row: int = 0) -> tuple[float, FloatArray]:
    """Check that `columns[0]` is an even time base; return (step [s], columns on it).

    `columns` has shape (1 + channels, n). A step that differs from the median by more than 1 % is refused with
    its row (counted from `first_row`) unless `resample` asks for linear interpolation.
    """
    time = columns[0]
    if time.shape[0] < 2:
        raise BadRecord(f"{source}: has {time.shape[0]} samples; at least 2 are needed")
    steps = np.diff(time)
    if np.isnan(time).any():
        raise BadRecord(f"{source}, row {first_row + int(np.argmax(np.isnan(time)))}: time is missing; every row needs it")
    if (backward := steps <= 0).any():
        row = first_row + 1 + int(np.argmax(backward))
        raise BadRecord(f"{source}, row {row}: time does not increase; rows must be in order of time")
    median = float(np.median(steps))
    uneven = np.abs(steps - median) > JITTER * median + 4 * float(np.spacing(np.abs(time).max()))
    if not uneven.any():
        return float((time[-1] - time[0]) / (len(time) - 1)), columns
    if resample:
        even = time[0] + median * np.arange(int(np.floor((time[-1] - time[0]) / median + 1e-6)) + 1)
        return median, np.stack([even, *(np.interp(even, time, column) for column in columns[1:])])
    row, found = first_row + 1 + int(np.argmax(uneven)), float(steps[np.argmax(uneven)])
    raise BadRecord(
        f"{source}, row {row}: time step {found:.6g} s differs from {median:.6g} s by more than 1 %; resample to accept it"
    )
