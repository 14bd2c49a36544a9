"""How fast a shaft turns, as a record's speed channel says, in whatever unit that was written."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from residuum.identification.errors import BadInput, Way
from residuum.identification.record import Record
from residuum.identification.units import convert, parse_unit

FloatArray = npt.NDArray[np.float64]
_WORDS = ("speed", "rpm", "drehzahl")
_SAME = 0.005  # of the speed: two channels that differ by less tell of one shaft


def turns_per_minute(values: npt.ArrayLike, unit: str, *, what: str = "speed") -> FloatArray:
    """Values of a channel that is said to be a speed of rotation [rpm].

    A unit that names an angle (rad/s, °/s, rpm) is converted; one that only counts in time (Hz, 1/s, min^-1) counts turns,
    for a shaft that goes round 30 times a second is written as 30 Hz.

    Raises BadInput for a unit that is neither.

    >>> [round(float(turns_per_minute(30.0, unit)), 1) for unit in ("Hz", "min^-1", "rpm", "°/s")]
    [1800.0, 30.0, 30.0, 5.0]
    """
    if not is_turning(unit):
        raise BadInput(f"{what}: {unit!r} is no unit of a speed of rotation; known are rpm, 1/min, Hz, 1/s, rad/s, °/s")
    if "radian" in parse_unit(unit).base:
        return convert(values, unit, "rpm", what=what)
    return np.asarray(values, dtype=float) * (60.0 * parse_unit(unit).scale)


def is_turning(unit: str) -> bool:
    """Whether a speed of rotation may be in this unit: an angle, or turns, in time.

    >>> [is_turning(unit) for unit in ("Hz", "rad/s", "min^-1", "%/s", "rad/s**2", "m/s", "")]
    [True, True, True, False, False, False, False]
    """
    parsed = parse_unit(unit)
    return parsed.base in ({"second": -1.0}, {"second": -1.0, "radian": 1.0}) and "%" not in parsed.symbols


def speed_channel(record: Record) -> str | None:
    """The channel that tells the speed of the shaft: its name says so, and its unit is one of rotation; None without one.

    Raises BadInput when several tell different speeds, for then nobody knows which of them is the bearing's shaft.
    """
    found = [name for name in _named_so(record) if is_turning(record.units[name])]
    if "speed" in found:
        return "speed"
    speeds = {name: speed for name in found if (speed := _usual(record, name))}
    if len(speeds) > 1 and max(speeds.values()) > (1 + _SAME) * min(speeds.values()):
        told = ", ".join(f"{name!r} {speed:.4g} rpm" for name, speed in speeds.items())
        raise BadInput(
            f"bearing: record {record.source!r} has several speeds ({told})",
            way_on=[("map", {"speed": "CHANNEL"}, "of the shaft")],
        )
    return next(iter(speeds), found[0] if found else None)


def speed_in_rpm(record: Record, name: str) -> FloatArray:
    """The magnitude of the shaft's speed at every sample [rpm], shape (n,); missing samples stay missing."""
    return np.abs(turns_per_minute(record[name], record.units[name], what=f"channel {name!r}"))


def only_speed_channel(record: Record) -> str | None:
    """The speed channel; none of several, which are no reason to refuse a record whose speed was said apart."""
    try:
        return speed_channel(record)
    except BadInput:
        return None


def usual_speed(record: Record, name: str | None) -> float | None:
    """Median of a speed channel [rpm]; None without a channel, or where it stands still."""
    return None if name is None else _usual(record, name)


def unusable_speeds(record: Record) -> tuple[str, list[Way]]:
    """What is wrong with channels whose name tells of a speed (no unit, or none of rotation), and what may be said of them."""
    units = {name: record.units[name] for name in _named_so(record) if not is_turning(record.units[name])}
    said = [f"channel {name!r} " + (f"is in {unit!r}" if unit else "has no unit") for name, unit in units.items()]
    return "; ".join(said), [("units", {name: "rpm"}) for name, unit in units.items() if not unit]


def _named_so(record: Record) -> list[str]:
    return [name for name in record.names if any(word in name.lower() for word in _WORDS)]


def _usual(record: Record, name: str) -> float | None:
    speed = speed_in_rpm(record, name)
    known = speed[np.isfinite(speed)]
    return (float(np.median(known)) or None) if known.size else None
