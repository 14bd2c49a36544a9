"""Fault frequencies of a rolling bearing: from its geometry, as multiples of shaft speed, or in hertz."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import cos, radians
from types import MappingProxyType

from residuum.identification.errors import BadInput
from residuum.nearest_names import known_names

CLASS_OF = MappingProxyType({"bpfi": "inner-race", "bpfo": "outer-race", "bsf": "ball", "ftf": "cage"})


@dataclass(frozen=True)
class BearingFrequencies:
    """Frequencies [Hz] at which faults of a bearing strike, and the shaft's where it is known.

    `lines` maps `bpfi`, `bpfo`, `bsf`, `ftf` (any of them) to hertz; `bsf` is the ball's own rotation: a spot on it strikes
    both races, so its impacts come at twice that.
    """

    lines: Mapping[str, float]
    shaft: float | None = None

    @classmethod
    def from_orders(cls, orders: Mapping[str, float], shaft: float) -> BearingFrequencies:
        """From multiples of the shaft frequency [Hz]."""
        _check(orders, "orders")
        if not shaft > 0:
            raise BadInput(f"shaft frequency is {shaft!r} Hz; must be positive")
        return cls({name: order * shaft for name, order in orders.items()}, shaft)

    @classmethod
    def from_hertz(cls, hertz: Mapping[str, float], shaft: float | None = None) -> BearingFrequencies:
        """From hertz; an entry `shaft` is the shaft's own frequency.

        When it is not known but BPFI, BPFO and FTF are, it follows: BPFO = N FTF gives N, BPFI = N (f_shaft − FTF) the shaft.

        >>> round(BearingFrequencies.from_hertz({"bpfi": 162.1, "bpfo": 107.3, "ftf": 11.92}).shaft, 1)
        29.9
        """
        lines = {name: value for name, value in hertz.items() if name != "shaft"}
        _check(lines, "hertz")
        shaft = hertz.get("shaft", shaft)
        if shaft is None and {"bpfi", "bpfo", "ftf"} <= lines.keys():
            balls = round(lines["bpfo"] / lines["ftf"])
            if balls and abs(lines["bpfo"] / lines["ftf"] / balls - 1) < 0.01:
                shaft = lines["bpfi"] / balls + lines["ftf"]
        return cls(lines, shaft)


def orders_from_geometry(balls: int, ball_diameter: float, pitch_diameter: float, contact_angle: float = 0.0) -> dict[str, float]:
    """Fault frequencies as multiples of shaft speed, inner ring turning, outer ring at rest, no slip.

    With r = (d / D) cos φ: BPFO = N/2 (1 − r), BPFI = N/2 (1 + r), BSF = D/(2d) (1 − r²), FTF = (1 − r)/2.

    Parameters
    ----------
    balls : N
    ball_diameter, pitch_diameter : d, D in one unit, 0 < d < D
    contact_angle : φ [°]

    Examples
    --------
    A 6205-2RS of a well-known test rig:

    >>> {name: round(order, 3) for name, order in orders_from_geometry(9, 0.3126, 1.537).items()}
    {'bpfi': 5.415, 'bpfo': 3.585, 'bsf': 2.357, 'ftf': 0.398}
    """
    if balls < 1 or not 0 < ball_diameter < pitch_diameter:
        raise BadInput(f"bearing: {balls} balls of {ball_diameter:g} on {pitch_diameter:g}; needs N ≥ 1 and 0 < d < D")
    r = ball_diameter / pitch_diameter * cos(radians(contact_angle))
    return {
        "bpfi": balls / 2 * (1 + r),
        "bpfo": balls / 2 * (1 - r),
        "bsf": pitch_diameter / (2 * ball_diameter) * (1 - r * r),
        "ftf": (1 - r) / 2,
    }


def _check(lines: Mapping[str, float], what: str) -> None:
    for name, value in lines.items():
        if name not in CLASS_OF:
            raise BadInput(f"{what}: {name!r} is no fault line; {known_names(name, CLASS_OF)}")
        if not 0 < value < float("inf"):
            raise BadInput(f"{what}: {name} is {value!r}; must be a positive number")
    if not lines:
        raise BadInput(f"{what}: names no fault line; known are {', '.join(CLASS_OF)}")
