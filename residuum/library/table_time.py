"""The time of a table (a DataFrame, a Dataset): instants, durations, seconds; never a count of its
rows.
"""

from __future__ import annotations

from datetime import UTC
from typing import Any

import numpy as np
import numpy.typing as npt

from residuum.identification.errors import BadRecord
from residuum.identification.record_formats.loggers.logger_head import unit_of_head
from residuum.identification.record_formats.loggers.logger_time import seconds_of

_EPOCH = 1e11
"""Above this a number is no second of our days, since 1970 or since a start."""


def seconds(
    values: Any, where: str, *, unit: str = "", told: bool = False, near: str = "COLUMN"
) -> npt.NDArray[np.float64]:
    """Instants or durations as seconds, shape (n,); instants count from the first one.

    `unit` is the unit of plain numbers (seconds where nothing is said). Whole numbers without one
    count the rows as likely as they count seconds; they are taken where the caller has `told` that
    they are the time. `near` is a column that may be it.

    Raises BadRecord with what to do for anything that is no time.
    """
    if getattr(values, "nlevels", 1) > 1:
        raise BadRecord(
            f"{where}: the index has {values.nlevels} levels; take one series, frame.xs(…) or"
            " frame.droplevel(…)"
        )
    if str(getattr(values, "dtype", "")).startswith("period"):
        values = getattr(values, "dt", values).to_timestamp()
    array = _without_zone(values)
    if array.dtype.kind in "mM":
        return np.asarray((array - array[0]) / np.timedelta64(1, "ns") * 1e-9, dtype=float)
    if array.dtype.kind not in "iuf":
        raise BadRecord(
            f"{where}: the time does not hold numbers or instants ({str(array[0])[:30]!r}); make"
            " instants of it with pandas.to_datetime(…), or say sample_time=…"
        )
    factor = seconds_of(unit) if unit else 1.0
    if factor is None:
        raise BadRecord(f"{where}: the time is in {unit!r}, which is no unit of time")
    if array.dtype.kind in "iu" and not unit and not told:
        raise BadRecord(
            f"{where}: the index counts ({array[0]}, {array[min(1, len(array) - 1)]}, …), which may"
            f" be rows and is not taken for seconds; say time={near!r}, sample_time=…, or make"
            " instants of it: pandas.to_datetime(frame.index, unit=…)"
        )
    if not unit and np.nanmax(np.abs(array), initial=0.0) > _EPOCH:
        how = "make instants of it with pandas.to_datetime(…, unit='ms')"
        raise BadRecord(f"{where}: the time {array[0]:.0f} is too large for seconds; {how}")
    return np.asarray(array, dtype=float) * factor


def unit_of_time(head: Any) -> str:
    """The unit of time in the head of a column or in the name of an index (`t [ms]`), or
    nothing.
    """
    unit = unit_of_head(str(head or ""))[1]
    return "" if seconds_of(unit) is None else unit


def refuse_disorder(instants: npt.NDArray[np.float64], where: str) -> None:
    """BadRecord for instants that stand twice or go back, with what a table has for it."""
    steps = np.diff(instants)
    if not (wrong := steps <= 0).any():
        return
    row = int(np.argmax(wrong)) + 1
    if steps[row - 1] == 0:
        how = (
            "an instant stands twice: frame.groupby(level=0).mean() or"
            " frame[~frame.index.duplicated()] keeps one"
        )
    else:
        how = "rows must be in order of time: frame.sort_index() orders them"
    raise BadRecord(f"{where}, row {row}: time does not increase; {how}")


def _without_zone(values: Any) -> npt.NDArray[Any]:
    """The array of values; instants with a zone become those of UTC, in which no hour stands
    twice.
    """
    accessor = getattr(values, "dt", values)
    if getattr(accessor, "tz", None) is not None:
        return np.asarray(accessor.tz_convert(None))
    array = np.asarray(values)
    if (
        array.dtype.kind == "O"
        and len(array)
        and all(hasattr(t, "isoformat") and hasattr(t, "hour") for t in array)
    ):
        return _of_datetimes(array)
    return _plain(array) if array.dtype.kind == "O" else array


def _plain(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Numbers that came as objects, or the objects as they are."""
    if any(isinstance(entry, str) for entry in array):
        return array
    try:
        return np.asarray(array, dtype=float)
    except (TypeError, ValueError):
        return array


def _of_datetimes(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    return np.array(
        [t.astimezone(UTC).replace(tzinfo=None) if t.tzinfo else t for t in array],
        dtype="datetime64[ns]",
    )
