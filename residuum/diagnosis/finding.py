"""Finding: what a diagnoser says of one window."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np


class Verdict(StrEnum):
    """The three things that can be said of a window."""

    HEALTHY = "healthy"
    FAULTY = "faulty"
    NOT_ASSESSABLE = "not-assessable"


TOLD_BESIDE = ("causes", "parameters", "false_alarms_per_day")
"""Evidence that the `score` object also has at its top level, where a diagnoser tells causes."""

RECORDED = "recorded_without_baseline"
"""Evidence of a window that was kept and not judged."""

LIMITS_HOLD = "absolute_limits_hold"
"""Evidence of a window that passes no absolute limit, and has no baseline by which it could be
called healthy.
"""


class Ne107(StrEnum):
    """Categories of NAMUR recommendation NE 107: what somebody is to do about a device."""

    GOOD = "good"
    FUNCTION_CHECK = "function-check"
    OUT_OF_SPECIFICATION = "out-of-specification"
    MAINTENANCE_REQUIRED = "maintenance-required"
    FAILURE = "failure"


_CATEGORY_OF_CAUSE = {
    "sensor": Ne107.FAILURE,
    "actuator": Ne107.FAILURE,
    "disturbance": Ne107.OUT_OF_SPECIFICATION,
    "unknown": Ne107.OUT_OF_SPECIFICATION,
}


class Statement(NamedTuple):
    """What a finding names, in a few words, and how probable it calls that (None: it does not
    say).
    """

    says: str
    probability: float | None


@dataclass(frozen=True)
class Finding:
    """Verdict on one window with the numbers it rests on.

    Parameters
    ----------
    diagnoser : str
        Name in the catalogue of diagnosers.
    verdict : Verdict
        `not-assessable` is a verdict, not an error: `reason` then says why, in one sentence.
    fault_class : str or None
        The kind of fault, where the diagnoser tells kinds apart.
    indicators, thresholds : mapping of name to number
        An indicator with a threshold of the same name is judged by it.
    units : mapping of name to unit
        Unit of each indicator (absent = dimensionless).
    evidence : mapping
        JSON-able material a person can check: band, frequency, samples, baseline size,
        probabilities.
    reason : str or None
        One sentence with the numbers: why this verdict.

    Raises
    ------
    ValueError
        `not-assessable` without a reason, or `healthy` with a fault class.
    """

    diagnoser: str
    verdict: Verdict
    fault_class: str | None = None
    indicators: Mapping[str, float] = field(default_factory=dict)
    thresholds: Mapping[str, float] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    evidence: Mapping[str, Any] = field(default_factory=dict)
    reason: str | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "verdict", Verdict(self.verdict))
        if self.verdict is Verdict.NOT_ASSESSABLE and not self.reason:
            raise ValueError("Finding, reason: a not-assessable finding must say why")
        if self.verdict is Verdict.HEALTHY and self.fault_class is not None:
            raise ValueError("Finding, fault_class: a healthy finding has none")

    @classmethod
    def not_assessable(cls, diagnoser: str, reason: str, **evidence: Any) -> Finding:
        """The finding for a window that cannot be judged, with the sentence that says why."""
        return cls(diagnoser, Verdict.NOT_ASSESSABLE, evidence=evidence, reason=reason)

    @classmethod
    def recorded(cls, diagnoser: str) -> Finding:
        """The finding on a window that came before there was a baseline: the window is kept to
        train one. It raises no alarm.
        """
        says = (
            "there is no baseline yet: the window is recorded, so that one can be trained from it"
        )
        return cls.not_assessable(diagnoser, says, **{RECORDED: True})

    def without_baseline(self, held: str) -> Finding:
        """This healthy finding as it may be said without a baseline: not assessable, with the
        absolute limits that it held.
        """
        says = (
            "there is no baseline to compare with, so that health cannot be told; no absolute"
            f" limit is passed: {held}"
        )
        says = f"{says}; {self.reason}" if self.reason else says
        return replace(
            self,
            verdict=Verdict.NOT_ASSESSABLE,
            evidence={**self.evidence, LIMITS_HOLD: True},
            reason=says,
        )

    def with_remarks(self, remarks: Sequence[str]) -> Finding:
        """This finding with what no verdict depends on told beside it: in `evidence` and behind the
        reason.
        """
        if not remarks:
            return self
        says = "; ".join([*([self.reason] if self.reason else []), *remarks])
        return replace(self, evidence={**self.evidence, "remarks": list(remarks)}, reason=says)

    @property
    def within_absolute_limits(self) -> bool:
        """Whether every absolute limit holds, and no more can be said, because there was no
        baseline.
        """
        return bool(self.evidence.get(LIMITS_HOLD))

    @property
    def statement(self) -> Statement:
        """What can be confirmed or refuted at the machine: of a faulty finding its likeliest cause,
        else its fault class, else that it is faulty; of any other the verdict.

        >>> cause = {"name": "coulomb-friction", "place": "shaft", "probability": 0.8}
        >>> Finding("model-based", "faulty", evidence={"causes": [cause]}).statement
        Statement(says='coulomb-friction of shaft', probability=0.8)
        """
        if self.verdict is not Verdict.FAULTY:
            return Statement(self.verdict.value, None)
        causes = self.evidence.get("causes") or []
        if causes:
            name, place = causes[0]["name"], causes[0]["place"]
            says = f"{name} of {place}" if place else str(name)
            return Statement(says, causes[0].get("probability"))
        classes = self.evidence.get("probabilities") or {}
        return Statement(self.fault_class or self.verdict.value, classes.get(self.fault_class))

    @property
    def ne107(self) -> Ne107:
        """The category of NE 107, as this package reads it.

        Healthy is good. What could not be judged asks for a function check. Of a faulty finding the
        kind of the likeliest cause decides: a signal that cannot be trusted, or an actuator that
        does not follow, is a failure; a disturbance, or what no known cause explains, is out of
        specification; anything else that changed asks for maintenance.

        >>> Finding("bearing", "faulty", "ball").ne107.value
        'maintenance-required'
        """
        if self.verdict is Verdict.HEALTHY:
            return Ne107.GOOD
        if self.verdict is Verdict.NOT_ASSESSABLE:
            return Ne107.FUNCTION_CHECK
        causes = self.evidence.get("causes") or [{}]
        kind = str(causes[0].get("kind", ""))
        return _CATEGORY_OF_CAUSE.get(kind, Ne107.MAINTENANCE_REQUIRED)

    @property
    def only_recorded(self) -> bool:
        """Whether nothing was judged, because there was no baseline."""
        return bool(self.evidence.get(RECORDED))

    def to_json(self) -> dict[str, Any]:
        """The finding as plain JSON values (the `score` object of the command line and the HTTP
        interface).
        """
        outer = {name: _plain(self.evidence[name]) for name in TOLD_BESIDE if name in self.evidence}
        return outer | {
            "diagnoser": self.diagnoser,
            "verdict": self.verdict.value,
            "class": self.fault_class,
            "ne107": self.ne107.value,
            "indicators": _plain(self.indicators),
            "thresholds": _plain(self.thresholds),
            "units": dict(self.units),
            "evidence": _plain(self.evidence),
            "reason": self.reason,
        }


def _plain(value: Any) -> Any:
    """JSON values only: arrays become lists, NumPy numbers Python ones, non-finite numbers null."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
