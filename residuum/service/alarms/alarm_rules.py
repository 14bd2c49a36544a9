"""AlarmRule: when what a machine shows becomes an alarm, and when it no longer is one."""

from __future__ import annotations

import math
from collections.abc import Mapping

from pydantic import BaseModel, ConfigDict, Field


class AlarmRule(BaseModel):
    """Deadband, delays and latch of the alarms of a machine (ANSI/ISA-18.2, clause 10)."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    deadband: float = Field(default=0.0, ge=0, lt=1, description="A standing alarm clears below (1 − deadband) · threshold only.")
    on_delay: float = Field(
        default=0.0, ge=0, le=86_400, description="Seconds for which a fault must be seen to raise the alarm."
    )
    off_delay: float = Field(default=0.0, ge=0, le=86_400, description="Seconds without the fault that clear the alarm.")
    latch: bool = Field(default=False, description="The alarm stays when its condition goes, until it is acknowledged and reset.")


def severity(indicators: Mapping[str, float | None], thresholds: Mapping[str, float | None]) -> float:
    """How far the worst indicator lies beyond its threshold τ, max x/τ; 0 where none has one.

    >>> severity({"rms": 3.0, "kurtosis": 4.0}, {"rms": 1.0, "kurtosis": 8.0})
    3.0
    """
    pairs = [(indicators.get(name), tau) for name, tau in thresholds.items()]
    return max((x / tau for x, tau in pairs if x is not None and tau is not None and tau > 0 and x / tau < math.inf), default=0.0)


def in_deadband(rule: AlarmRule, indicators: Mapping[str, float | None], thresholds: Mapping[str, float | None]) -> bool:
    """Whether an indicator lies below its threshold τ by less than the deadband d: (1 − d) τ < x ≤ τ.

    >>> in_deadband(AlarmRule(deadband=0.1), {"rms": 0.95}, {"rms": 1.0})
    True
    """
    for name, tau in thresholds.items():
        x = indicators.get(name)
        if x is not None and tau is not None and (1.0 - rule.deadband) * tau < x <= tau:
            return rule.deadband > 0.0
    return False
