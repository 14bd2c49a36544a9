"""A statistic held against a threshold over one window, as a finding shows it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray


@dataclass(frozen=True)
class ThresholdTest:
    """Name and unit of the indicator, its largest value, the threshold, and the sample of the first alarm (None: none)."""

    indicator: str
    unit: str
    largest: float
    threshold: float
    alarm: int | None

    @classmethod
    def of(
        cls, indicator: str, unit: str, statistic: FloatArray, alarm: npt.NDArray[np.bool_], threshold: float
    ) -> ThresholdTest:
        """Of a statistic sample by sample, shape (n,)."""
        first = int(np.argmax(alarm)) if alarm.any() else None
        return cls(indicator, unit, float(statistic.max()), threshold, first)

    def to_json(self, time: FloatArray) -> Mapping[str, Any]:
        """What the test alone says: verdict, numbers, time of the first alarm [s]."""
        return {
            "verdict": "healthy" if self.alarm is None else "faulty",
            "indicator": self.indicator,
            "value": self.largest,
            "threshold": self.threshold,
            "unit": self.unit,
            "first_alarm_time": None if self.alarm is None else float(time[self.alarm]),
        }
