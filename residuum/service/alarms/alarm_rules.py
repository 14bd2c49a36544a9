"""AlarmRule: when what a machine shows becomes an alarm, and when it no longer is one."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping

from pydantic import BaseModel, ConfigDict, Field


class AlarmRule(BaseModel):
    """Deadband, delays and latch of the alarms of a machine (ANSI/ISA-18.2, clause 10)."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    deadband: float = Field(
        default=0.0,
        ge=0,
        lt=1,
        description=(
            "A standing alarm clears only where the indicator that raised it lies deadband · |threshold| or more below its "
            "threshold; a threshold of 0 has no deadband."
        ),
    )
    on_delay: float = Field(
        default=0.0,
        ge=0,
        le=86_400,
        description=(
            "Seconds for which a fault must be seen to raise the alarm. Only time between windows that both show it counts; a "
            "pause longer than the delay, and twice as long as the one before, begins the count anew."
        ),
    )
    off_delay: float = Field(
        default=0.0, ge=0, le=86_400, description="Seconds without the fault that clear the alarm, counted like the on_delay."
    )
    latch: bool = Field(default=False, description="The alarm stays when its condition goes, until it is acknowledged and reset.")


def severity(indicators: Mapping[str, float | None], thresholds: Mapping[str, float | None]) -> float:
    """How far the worst indicator lies beyond its threshold τ, max x/τ; 0 where none has one.

    >>> severity({"rms": 3.0, "kurtosis": 4.0}, {"rms": 1.0, "kurtosis": 8.0})
    3.0
    """
    pairs = [(indicators.get(name), tau) for name, tau in thresholds.items()]
    return max((x / tau for x, tau in pairs if x is not None and tau is not None and tau > 0 and x / tau < math.inf), default=0.0)


def beyond(indicators: Mapping[str, float | None], thresholds: Mapping[str, float | None]) -> frozenset[str]:
    """The indicators above their thresholds.

    >>> sorted(beyond({"rms": 3.0, "kurtosis": 4.0}, {"rms": 1.0, "kurtosis": 8.0}))
    ['rms']
    """
    pairs = {name: (indicators.get(name), tau) for name, tau in thresholds.items()}
    return frozenset(name for name, (x, tau) in pairs.items() if x is not None and tau is not None and x > tau)


def in_deadband(
    rule: AlarmRule,
    indicators: Mapping[str, float | None],
    thresholds: Mapping[str, float | None],
    raised_by: Collection[str] | None = None,
) -> bool:
    """Whether one of the indicators that raised an alarm lies below its threshold τ by less than the deadband: τ − d |τ| < x ≤ τ.

    `raised_by` of None is any indicator: of an alarm of which nobody kept what raised it.

    >>> in_deadband(AlarmRule(deadband=0.1), {"rms": 0.95}, {"rms": 1.0}, {"rms"})
    True
    >>> in_deadband(AlarmRule(deadband=0.1), {"rms": 0.5, "kurtosis": 0.95}, {"rms": 1.0, "kurtosis": 1.0}, {"rms"})
    False
    """
    for name, tau in thresholds.items():
        x = indicators.get(name)
        counts = raised_by is None or name in raised_by
        if counts and x is not None and tau is not None and tau - rule.deadband * abs(tau) < x <= tau:
            return rule.deadband > 0.0
    return False
