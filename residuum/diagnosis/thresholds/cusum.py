"""Two-sided cumulative sum (CUSUM) of a standardised signal."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.kept_loops import njit


class CusumOutput(NamedTuple):
    """Per sample: the larger of the two sums, the alarms (+1 up, −1 down, 0 none) and the samples since that sum was zero."""

    statistic: FloatArray
    alarm: npt.NDArray[np.int64]
    since: npt.NDArray[np.int64]


def cusum(x: npt.ArrayLike, valid: npt.ArrayLike, reference: float, threshold: float) -> CusumOutput:
    """g⁺ = max(0, g⁺ + x − k), g⁻ = max(0, g⁻ − x − k); alarm when one exceeds h, after which both start at zero.

    Page (1954); optimal for a step of 2 k. Its false-alarm rate for independent standard normals is that of
    `cusum_threshold`; correlated x raise it, and a lasting model error larger than k makes it alarm for certain.

    Parameters
    ----------
    x, valid : arrays, shape (n,)
        Standardised signal; where `valid` is False both sums are zero.
    reference, threshold : float
        k and h [standard deviations].

    Examples
    --------
    >>> output = cusum([0.0] * 5 + [2.0] * 5, [True] * 10, 0.5, 4.0)
    >>> int(np.argmax(output.alarm)), int(output.since[np.argmax(output.alarm)])
    (7, 3)
    """
    x = np.ascontiguousarray(x, dtype=float)
    n = len(x)
    output = CusumOutput(np.zeros(n), np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64))
    _cusum(x, np.ascontiguousarray(valid, dtype=bool), float(reference), float(threshold), *output)
    return output


@njit()
def _cusum(x, valid, reference, threshold, statistic, alarm, since):  # type: ignore[no-untyped-def]
    up = down = 0.0
    risen = fallen = 0
    for t in range(len(x)):
        if not valid[t]:
            up = down = 0.0
            risen = fallen = 0
            continue
        up, down = max(0.0, up + x[t] - reference), max(0.0, down - x[t] - reference)
        risen = risen + 1 if up > 0.0 else 0
        fallen = fallen + 1 if down > 0.0 else 0
        statistic[t] = max(up, down)
        since[t] = risen if up >= down else fallen
        if statistic[t] > threshold:
            alarm[t] = 1 if up >= down else -1
            up = down = 0.0
            risen = fallen = 0
