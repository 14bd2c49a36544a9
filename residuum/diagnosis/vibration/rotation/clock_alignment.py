"""Two recorders with clocks of their own, brought onto one time base by the synchronisation pulses that both see."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from residuum.array_types import AnyArray
from residuum.identification.errors import BadRecord
from residuum.identification.record import Record

LARGEST_DRIFT = 1e-3  # crystal clocks differ by 1e-4 at most; more means that the pulses were paired wrongly
_SHORTEST_BASE = 20.0  # spacings: over fewer the reading error of one edge would pass for drift


@dataclass(frozen=True)
class ClockAlignment:
    """t_reference = t_middle + offset + (1 + drift) (t_other − t_middle).

    Attributes
    ----------
    offset : float
        Reading of the reference clock less that of the other, at `middle` [s].
    drift : float
        Relative rate difference [-]; 5e-5 is 50 ppm.
    middle : float
        Reading of the other clock about which the line was fitted [s].
    std : float
        Standard deviation of one pulse about the line [s].
    pulses : int
        Pairs that the fit rests on.
    """

    offset: float
    drift: float
    middle: float
    std: float
    pulses: int

    def to_reference(self, time: npt.ArrayLike) -> AnyArray:
        """Readings of the other clock [s] as readings of the reference clock [s]."""
        t = np.asarray(time, dtype=float)
        return self.middle + self.offset + (1 + self.drift) * (t - self.middle)

    def to_other(self, time: npt.ArrayLike) -> AnyArray:
        """Readings of the reference clock [s] as readings of the other clock [s]."""
        return self.middle + (np.asarray(time, dtype=float) - self.middle - self.offset) / (1 + self.drift)


def align_clocks(reference: npt.ArrayLike, other: npt.ArrayLike, expected_offset: float = 0.0) -> ClockAlignment:
    """Least-squares line through the paired pulse times of two clocks.

    Each pulse is paired with the nearest one of the other clock after shifting by `expected_offset`, which must therefore be
    known to less than half the pulse spacing. Pairs more than a fifth of the spacing off the median are left out
    (a pulse that only one recorder saw). The drift is estimated only over at least 20 spacings, otherwise taken as 0.

    Parameters
    ----------
    reference, other : arrays of pulse times [s]
    expected_offset : float
        First guess of the offset [s].

    Raises
    ------
    BadRecord
        No pulse can be paired, or the drift comes out above 0.1 %.

    Examples
    --------
    >>> true = np.arange(100.0)
    >>> alignment = align_clocks(true, 0.13 + true * (1 - 40e-6))
    >>> round(1e6 * alignment.drift), round(float(alignment.to_reference(50.13 - 0.002)), 6)
    (40, 50.0)
    """
    reference, other = np.asarray(reference, dtype=float), np.asarray(other, dtype=float)
    if reference.size == 0 or other.size == 0:
        raise BadRecord("clock alignment: one recorder saw no synchronisation pulse")
    nearest = np.abs(reference[None, :] - expected_offset - other[:, None]).argmin(axis=1)
    difference = reference[nearest] - other
    spacing = float(np.median(np.diff(other))) if other.size > 1 else np.inf
    paired = np.abs(difference - np.median(difference)) <= 0.2 * spacing
    t, d = other[paired], difference[paired]
    middle = float(t.mean())
    long_enough = t.size >= 3 and np.ptp(t) >= _SHORTEST_BASE * spacing
    drift = float(np.polynomial.Polynomial.fit(t - middle, d, 1).convert().coef[1]) if long_enough else 0.0
    if abs(drift) > LARGEST_DRIFT:
        raise BadRecord(
            f"clock alignment: the clocks drift by {1e6 * drift:.0f} ppm; at most {1e6 * LARGEST_DRIFT:.0f} is plausible"
        )
    rest = d - d.mean() - drift * (t - middle)
    return ClockAlignment(float(d.mean()), drift, middle, float(rest.std()), int(t.size))


def on_clock_of(reference: Record, other: Record, alignment: ClockAlignment, names: Iterable[str] | None = None) -> Record:
    """`reference` with channels of `other` added, each held from its last sample before; NaN where `other` has none.

    Holding (not interpolating) keeps two-valued signals two-valued; the error is less than one of other's sample times.
    A channel name that `reference` has already is left as it is.
    """
    at = (alignment.to_other(reference.time) - other.t0) / other.sample_time
    index = np.floor(at + 1e-9).astype(int)
    covered = (index >= 0) & (index < other.n)
    index = np.clip(index, 0, other.n - 1)
    channels, units = dict(reference.channels), dict(reference.units)
    for name in other.names if names is None else names:
        if name not in channels:
            channels[name] = np.where(covered, other[name][index], np.nan)
            units[name] = other.units[name]
    return replace(reference, channels=channels, units=units)
