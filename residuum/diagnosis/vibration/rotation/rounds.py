"""Rounds and quadrants of a rotating machine, cut by the pulses of its indicator signal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.array_types import AnyArray
from residuum.identification.errors import BadInput

_END_TOLERANCE = 0.1  # of a quadrant: a window cut at pulses ends where the next one would stand
_LONGER = 1.4  # times the median width: the pulse that marks the first plier


@dataclass(frozen=True, eq=False)
class Rounds:
    """Complete rounds in a record.

    Attributes
    ----------
    edges : array of int, shape (rounds, quadrants + 1)
        Segment s of round r is samples edges[r, s] … edges[r, s+1] − 1; the first starts at the record's first pulse.
    phase : int or None
        Quadrant (0 …) that the first segment is, counted from the longer pulse; None when no pulse is longer.
    """

    edges: AnyArray
    phase: int | None

    def quadrant(self, segment: int) -> int:
        """Quadrant (0 …) that a segment is; with an unknown phase the segment itself."""
        return (segment + (self.phase or 0)) % (self.edges.shape[1] - 1)

    @property
    def count(self) -> int:
        """Number of complete rounds."""
        return int(self.edges.shape[0])


def cut_rounds(indicator: npt.ArrayLike, quadrants: int = 4) -> Rounds:
    """Cut a record into rounds of `quadrants` segments, each from one rising edge of i(t) to the next.

    A record that starts inside a pulse starts with its edge; a record that ends where the next edge is due (within a
    tenth of a quadrant) ends with it, so that a window cut from pulse to pulse is one round. When one pulse in
    every round is longer than the others (Remark 6.2), it opens the first quadrant.

    Parameters
    ----------
    indicator : array, shape (n,)
        Binary signal at any two levels (the middle between its least and greatest value is the threshold).

    Raises
    ------
    BadInput
        Missing samples, no pulse, or uneven spacing (a pulse lost or extra): the message says which.

    Examples
    --------
    >>> pulse = np.zeros(100)
    >>> pulse[:10] = 1
    >>> cut_rounds(np.tile(pulse, 8)).edges.tolist()
    [[0, 100, 200, 300, 400], [400, 500, 600, 700, 800]]
    """
    i = np.asarray(indicator, dtype=float)
    rising, width = pulses(i)
    spacing = np.diff(rising)
    if spacing.size == 0:
        raise BadInput("indicator: shows fewer than two pulses; a round cannot be cut")
    quadrant = float(np.median(spacing))
    uneven = np.abs(spacing / quadrant - 1) > 0.35
    if uneven.any():
        at = int(np.argmax(uneven))
        raise BadInput(
            f"indicator: pulses at samples {rising[at]} and {rising[at + 1]} are {spacing[at] / quadrant:.2f} usual spacings "
            "apart; a pulse is lost or extra"
        )
    if abs(i.shape[0] - rising[-1] - spacing[-1]) <= _END_TOLERANCE * quadrant:
        rising = np.append(rising, i.shape[0])
    count = (rising.shape[0] - 1) // quadrants
    if count < 1:
        raise BadInput(f"indicator: shows {rising.shape[0] - 1} complete quadrants; a round needs {quadrants}")
    starts = quadrants * np.arange(count)
    return Rounds(rising[starts[:, None] + np.arange(quadrants + 1)], _phase(width, quadrants))


def pulses(indicator: AnyArray) -> tuple[AnyArray, AnyArray]:
    """First sample and width [samples] of each pulse; a pulse that the record's end cuts has width −1.

    Raises BadInput when samples are missing or the signal never changes.
    """
    if np.isnan(indicator).any():
        raise BadInput("indicator: has missing samples")
    low, high = indicator.min(), indicator.max()
    if not high > low:
        raise BadInput("indicator: never changes; no pulse was seen")
    up = indicator > (low + high) / 2
    rising = np.flatnonzero(up & ~np.concatenate([[False], up[:-1]]))
    falling = np.flatnonzero(~up & np.concatenate([[False], up[:-1]]))
    if falling.shape[0] < rising.shape[0]:
        return rising, np.append(falling - rising[: falling.shape[0]], -1)
    return rising, falling - rising


def _phase(width: AnyArray, quadrants: int) -> int | None:
    whole = width[width > 0]
    if whole.shape[0] < quadrants:
        return None
    longer = np.flatnonzero(width > _LONGER * np.median(whole))
    if longer.shape[0] == 0 or not np.all(np.diff(longer) == quadrants):
        return None
    return int(-longer[0]) % quadrants
