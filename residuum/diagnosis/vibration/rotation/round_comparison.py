"""Rounds overlapped with the healthy band: where in the round does a machine differ from its healthy self?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from residuum.array_types import AnyArray
from residuum.diagnosis.thresholds.healthy_band import HealthyBand

PLACES_OF_A_ROUND = 200  # along a round: 10 ms of a round of 2 s, long against a ring, short against a quadrant


@dataclass(frozen=True, eq=False)
class RoundComparison:
    """Envelope RMS along the round, now and in health (the overlap of Fig. 76; `quadrant_rms` gives the boxes of Fig. 77).

    Attributes
    ----------
    place : array, shape (places,)
        Middle of each place, in quadrants: 2.5 is the middle of the third.
    middle, upper : arrays, shape (places,)
        Healthy median and the limit that a healthy place passes with the chosen probability, shared over the places.
    rounds : array, shape (rounds, places)
        Of the record compared.
    quadrant_rms : array, shape (rounds, quadrants)
    """

    place: AnyArray
    middle: AnyArray
    upper: AnyArray
    rounds: AnyArray
    quadrant_rms: AnyArray

    @property
    def exceeding(self) -> AnyArray:
        """Share of the rounds that pass the limit at each place, shape (places,)."""
        return np.asarray((self.rounds > self.upper).mean(axis=0))


def round_profile(segments: Sequence[AnyArray]) -> AnyArray:
    """RMS in equal places of a round, from its segments in quadrant order, shape (PLACES_OF_A_ROUND,)."""
    each = PLACES_OF_A_ROUND // len(segments)
    return np.array([np.sqrt(np.mean(part * part)) for segment in segments for part in np.array_split(segment, each)])


def compare_rounds(healthy: HealthyBand, profiles: AnyArray, false_alarm: float, quadrants: int) -> RoundComparison:
    """Profiles of a record's rounds, shape (rounds, PLACES_OF_A_ROUND), beside the healthy ones."""
    place = (np.arange(PLACES_OF_A_ROUND) + 0.5) * quadrants / PLACES_OF_A_ROUND
    square = profiles.reshape(profiles.shape[0], quadrants, -1) ** 2
    upper = healthy.upper(false_alarm / PLACES_OF_A_ROUND, 1.3)
    return RoundComparison(place, np.exp(healthy.mean), upper, profiles, np.sqrt(square.mean(axis=2)))
