"""The shapes of answers, for the OpenAPI document."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Generic, TypeVar

from pydantic import BaseModel, Field

T = TypeVar("T")


class Problem(BaseModel):
    """RFC 9457 problem document."""

    type: str = Field(description="`urn:residuum:problem:…`, one a rule, or `about:blank`.")
    title: str
    status: int
    detail: str = Field(description="One line: what is wrong, where, which rule.")
    request_id: str = Field(
        description=(
            "The request's `X-Request-ID`, as it was sent or as we named it; log lines have it,"
            " too."
        )
    )


# Said once a router: every refusal has the same shape, whatever the route (RFC 9457).
PROBLEMS: dict[int | str, dict[str, Any]] = {
    "4XX": {
        "model": Problem,
        "description": "Refused; nothing was stored.",
        "content": {"application/problem+json": {}},
    },
}


class PageOf(BaseModel, Generic[T]):
    """One page of a list."""

    items: list[T]
    next_cursor: str | None = Field(description="Ask for the next page with it; null at the end.")


# These shapes are for the document alone: answers are written by orjson, without a pass through
# pydantic.
class ScoreAnswer(BaseModel):
    """What a diagnoser says of one window."""

    diagnoser: str
    verdict: str = Field(
        description="`healthy`, `faulty` or `not-assessable` (then `reason` says why)."
    )
    # `class` is a word of Python.
    fault_class: str | None = Field(alias="class")
    ne107: str = Field(
        description=(
            "Category of NAMUR NE 107: `good`, `function-check`, `out-of-specification`,"
            " `maintenance-required` or `failure`."
        )
    )
    indicators: dict[str, float | None]
    thresholds: dict[str, float | None]
    units: dict[str, str]
    evidence: dict[str, Any]
    reason: str | None
    causes: list[dict[str, Any]] | None = Field(
        default=None, description="model-based: what may have happened, likeliest first."
    )
    parameters: dict[str, Any] | None = Field(
        default=None, description="model-based: every value with its healthy band."
    )
    false_alarms_per_day: float | None = Field(
        default=None, description="model-based: the chosen rate."
    )


class ConfirmationAnswer(BaseModel):
    """What was found at a machine of what a finding said; of several on one finding the newest
    counts.
    """

    id: int
    asset: str
    finding: int
    window: int
    finding_at: datetime
    diagnoser: str
    verdict: str
    said: str = Field(description="The finding's likeliest cause, its fault class or its verdict.")
    probability: float | None = Field(description="Of what was said; null: it did not say.")
    outcome: str = Field(description="`confirmed`, `refuted`, `corrected`, or `damaged` rows.")
    cause: str | None = Field(description="What it was, where it was corrected.")
    part: str | None
    order: str | None
    who: str
    found_at: datetime
    note: str | None
    healthy: bool = Field(description="Whether its window may be learned from as a healthy one.")
    at: datetime
    by: str | None


class ReliabilityBin(BaseModel):
    """One tenth of said probabilities [low, high)."""

    low: float
    high: float
    n: int = Field(description="Findings that were said with it and answered.")
    found: int = Field(description="Of these, how many were found so.")
    said: float = Field(description="Mean probability that was said.")
    share: float = Field(description="Share that was found so.")
    low_95: float = Field(description="Clopper–Pearson, 95 %.")
    high_95: float
    agrees: bool = Field(description="Whether the mean that was said lies in the interval.")


class ReliabilityAnswer(BaseModel):
    """What was said with which probability, and how often it was found so."""

    answered: int = Field(description="Findings of which somebody told what was found.")
    without_probability: int = Field(description="Of these, said without one: in no bin.")
    outcomes: dict[str, int]
    bins: list[ReliabilityBin]
    calibration_error: float | None = Field(
        description="Mean over the findings of |said − share| of their bin; null without any."
    )


class FindingAnswer(ScoreAnswer):
    """A stored finding."""

    id: int
    asset: str
    window: int
    at: datetime
    confirmation: ConfirmationAnswer | None = Field(
        default=None, description="What was found at the machine; absent: nobody told."
    )


class WindowAnswer(BaseModel):
    """A stored window without its samples."""

    id: int
    asset: str
    received_at: datetime
    t0: float = Field(description="Time of the first sample [s], the recorder's clock.")
    sample_time: float = Field(description="Seconds between samples.")
    n: int
    units: dict[str, str] = Field(description="Unit by channel.")
    source: str
    size_bytes: int
    signal_let_go_at: datetime | None = Field(
        description="When the samples were removed by the retention rule; null: kept."
    )


class StoredWindowAnswer(BaseModel):
    """A window that is on disk, with what was found."""

    window: WindowAnswer
    finding: FindingAnswer


class AssetAnswer(BaseModel):
    """A machine with its latest finding."""

    id: str
    title: str
    diagnoser: str | None
    created_at: datetime
    windows: int
    state: str = Field(description="The latest verdict, `no-baseline` or `no-data`.")
    last_finding: FindingAnswer | None


class AlarmAnswer(BaseModel):
    """An alarm; its states are those of ISA-18.2."""

    id: int
    asset: str
    kind: str = Field(
        description="`machine` (a fault was found) or `signal` (windows cannot be judged)."
    )
    state: str
    condition: bool = Field(description="Whether the latest judged window still shows it.")
    message: str = Field(
        description="What the worst finding since the alarm was raised says, and since when."
    )
    worst_at: datetime | None = Field(description="When that finding was.")
    occurrences: int
    raised_at: datetime | None
    cleared_at: datetime | None
    acknowledged_at: datetime | None
    acknowledged_by: str | None
    shelved_until: datetime | None
    comment: str | None
    window: int | None
    priority: str | None = Field(
        description="`high`, `medium` or `low` by its rule when it was raised; null: no rule says."
    )
    suppressed_by: str | None = Field(
        description="State of the machine that suppresses it; null: none, or somebody did."
    )


class AlarmOccurrenceAnswer(BaseModel):
    """One time that an alarm was raised, and what became of it."""

    id: int
    alarm: int
    asset: str
    kind: str = Field(
        description="`machine` (a fault was found) or `signal` (windows cannot be judged)."
    )
    raised_at: datetime
    cleared_at: datetime | None = Field(description="null: it stands.")
    acknowledged_at: datetime | None
    acknowledged_by: str | None
    comments: list[str]
    message: str | None = Field(
        description="Of the finding that raised it; null where its row was let go."
    )
    times_threshold: float | None = Field(
        description="The largest indicator over its threshold when it was raised."
    )
    window: int | None
    priority: str | None = Field(description="Of the alarm, when it was raised last.")


class AlarmRatesAnswer(BaseModel):
    """How often alarms are raised (ANSI/ISA-18.2, clause 16)."""

    last_10_minutes: int
    last_hour: int
    last_day: int
    highest_in_10_minutes: int = Field(description="Most in any ten minutes of the last day.")
    flood: bool = Field(description="More than ten in the last ten minutes.")
    flood_share: float = Field(
        description="Share of the last day's intervals of ten minutes that were floods."
    )
    standing: dict[str, int] = Field(description="Alarms in each state.")
    stale: list[int] = Field(description="Alarms on the list for over a day.")
    chattering: list[int] = Field(description="Alarms raised three times within a minute.")
    most_frequent: list[dict[str, Any]] = Field(
        description="The alarms raised most often in the last day."
    )


class AuditAnswer(BaseModel):
    """One line of the audit trail."""

    number: int
    at: datetime
    by: str | None
    action: str
    subject: str
    detail: dict[str, Any]
    digest: str = Field(description="SHA-256 over this entry and the digest before it.")


class RecordAnswer(BaseModel):
    """An uploaded record without its samples."""

    id: int
    name: str
    created_at: datetime
    t0: float
    sample_time: float
    n: int
    units: dict[str, str]
    notes: list[str]
    size_bytes: int


class ModelVersionAnswer(BaseModel):
    """One version of a stored model."""

    model: str
    kind: str
    number: int
    created_at: datetime
    created_by: str | None
    note: str
    size_bytes: int
    checksum: str = Field(description="SHA-256 of the content.")


class JobAnswer(BaseModel):
    """Long work: `refused` is bad input, `failed` an internal error."""

    id: str
    kind: str
    state: str
    progress: float = Field(description="Share done, 0 to 1.")
    doing: str
    created_at: datetime
    finished_at: datetime | None
    result: dict[str, Any] | None = None
    error: str | None


class SignalAnswer(BaseModel):
    """A stretch of a window, reduced to minimum and maximum an interval where it is long."""

    window: int | None
    start: float = Field(
        description="Time of the first sample of the stretch after the window's begin [s]."
    )
    interval: float = Field(
        description="Seconds one value (or one pair of minimum and maximum) stands for."
    )
    reduced: bool
    n: int = Field(description="Samples in the stretch.")
    channels: dict[str, dict[str, Any]] = Field(
        description="By name: `unit` and `values`, or `minimum` and `maximum`."
    )


class SpectrumAnswer(BaseModel):
    """Amplitude spectrum of one channel, reduced to the maximum an interval."""

    window: int
    channel: str
    unit: str
    step: float = Field(description="Hertz between values.")
    amplitude: list[float | None]
    resolution: float = Field(description="Frequency resolution of the estimate [Hz].")
