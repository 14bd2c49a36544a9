"""What the service keeps, as values; `storage.disk_store` keeps them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from enum import StrEnum
from typing import Any, Generic, TypeVar

import numpy.typing as npt

from residuum.diagnosis.finding import Finding
from residuum.identification.errors import BadInput
from residuum.service.alarms.alarm_states import AlarmState


class NotFound(BadInput):
    """There is no such thing in the store; the message names it."""


class Conflict(BadInput):
    """The request contradicts what is stored (an idempotency key used twice for different windows,
    a name taken).
    """


class SignalLetGo(BadInput):
    """The signal was removed by the retention rule; the window's row and findings are still
    there.
    """


class StorageUnavailable(Exception):
    """The disk or the database cannot take a write; `full` tells a full disk from a read-only or
    absent one.
    """

    def __init__(self, message: str, *, full: bool = False) -> None:
        super().__init__(message)
        self.full = full


T = TypeVar("T")


@dataclass(frozen=True)
class _Plain:
    """A row, which is answered as it is."""

    def to_json(self) -> dict[str, Any]:
        """Its members as plain values."""
        return asdict(self)


@dataclass(frozen=True)
class Page(Generic[T]):
    """One page of a list; `next_cursor` asks for the next, None at the end."""

    items: Sequence[T]
    next_cursor: str | None


class Outcome(StrEnum):
    """What was found at a machine of what a finding said: it was so, there was no such thing, or it
    was something else.
    """

    CONFIRMED = "confirmed"
    REFUTED = "refuted"
    CORRECTED = "corrected"


@dataclass(frozen=True)
class FoundAtMachine:
    """What somebody found at a machine, as it is told.

    `cause` is what it was where it was corrected, `who` looked (None: whoever tells it) and
    `found_at` when (None: now). `healthy` says of a refuted fault that its window may be learned
    from as a healthy one.
    """

    outcome: Outcome
    cause: str | None = None
    part: str | None = None
    order: str | None = None
    who: str | None = None
    found_at: datetime | None = None
    note: str | None = None
    healthy: bool = False


@dataclass(frozen=True)
class Confirmation(_Plain):
    """What was found at a machine beside what a finding said; of several on one finding the newest
    counts.

    `said` and `probability` are the finding's statement, kept here because a finding's row may be
    let go. `outcome` is `damaged` where the row differs from its checksum.
    """

    id: int
    asset: str
    finding: int
    window: int
    finding_at: datetime
    diagnoser: str
    verdict: str
    said: str
    probability: float | None
    outcome: str
    cause: str | None
    part: str | None
    order: str | None
    who: str
    found_at: datetime
    note: str | None
    healthy: bool
    at: datetime
    by: str | None


@dataclass(frozen=True)
class StoredFinding:
    """A finding with its place and time (UTC), and what was found at the machine, None where nobody
    has told.
    """

    id: int
    asset: str
    window: int
    at: datetime
    finding: Finding
    confirmation: Confirmation | None = None

    def to_json(self) -> dict[str, Any]:
        """The `score` object with where and when, and what was found at the machine where it is
        known.
        """
        found = {} if self.confirmation is None else {"confirmation": self.confirmation.to_json()}
        return {
            "id": self.id,
            "asset": self.asset,
            "window": self.window,
            "at": self.at,
            **self.finding.to_json(),
            **found,
        }


@dataclass(frozen=True)
class StoredWindow(_Plain):
    """One stored window: what it holds and where it came from; the samples are read apart.

    `t0` is the recorder's clock [s]; `signal_let_go_at` is when the retention rule removed the
    samples, None while they are kept.
    """

    id: int
    asset: str
    received_at: datetime
    t0: float
    sample_time: float
    n: int
    units: Mapping[str, str]
    source: str
    size_bytes: int
    signal_let_go_at: datetime | None


@dataclass(frozen=True)
class ReadInPieces:
    """A stored record whose samples are read piece by piece: a long signal is never held as a
    whole.

    `pieces(name)` gives a channel's samples in their order. What is damaged shows at the end, as an
    exception instead of an end: what was made of the pieces before is not to be answered with then.
    """

    sample_time: float
    t0: float
    n: int
    units: Mapping[str, str]
    notes: Sequence[str]
    dtypes: Mapping[str, str]
    pieces: Callable[[str], Iterator[npt.NDArray[Any]]]


@dataclass(frozen=True)
class Asset:
    """One machine, with its latest finding."""

    id: str
    title: str
    diagnoser: str | None
    created_at: datetime
    windows: int
    last_finding: StoredFinding | None

    def to_json(self) -> dict[str, Any]:
        """The asset; `state` is the latest verdict, `no-baseline` while windows are only recorded,
        or `no-data`.
        """
        last = self.last_finding
        if last is None:
            state = "no-data"
        elif last.finding.only_recorded:
            state = "no-baseline"
        else:
            state = last.finding.verdict.value
        return {
            "id": self.id,
            "title": self.title,
            "diagnoser": self.diagnoser,
            "created_at": self.created_at,
            "windows": self.windows,
            "state": state,
            "last_finding": last.to_json() if last else None,
        }


@dataclass(frozen=True)
class Alarm(_Plain):
    """One alarm of one asset. `kind` tells a fault of the machine from one of its signals.

    `message` and `window` are of the worst finding since the alarm was raised, which is of
    `worst_at`.
    """

    id: int
    asset: str
    kind: str
    state: AlarmState
    condition: bool
    message: str
    worst_at: datetime | None
    occurrences: int
    raised_at: datetime | None
    cleared_at: datetime | None
    acknowledged_at: datetime | None
    acknowledged_by: str | None
    shelved_until: datetime | None
    comment: str | None
    window: int | None
    priority: str | None = None
    suppressed_by: str | None = None


@dataclass(frozen=True)
class AlarmEntry(_Plain):
    """One line of an alarm's journal."""

    at: datetime
    event: str
    state: AlarmState
    by: str | None
    comment: str | None


@dataclass(frozen=True)
class AlarmOccurrence(_Plain):
    """One time that an alarm was raised, with what raised it and what became of it; `cleared_at` is
    None while it stands.

    `message`, `times_threshold` (the largest indicator over its threshold) and `window` are those
    of the finding that raised it; None where its row was let go.
    """

    id: int
    alarm: int
    asset: str
    kind: str
    raised_at: datetime
    cleared_at: datetime | None
    acknowledged_at: datetime | None
    acknowledged_by: str | None
    comments: Sequence[str]
    message: str | None
    times_threshold: float | None
    window: int | None
    priority: str | None = None


@dataclass(frozen=True)
class AuditEntry(_Plain):
    """One line of the audit trail; `digest` chains it to the one before."""

    number: int
    at: datetime
    by: str | None
    action: str
    subject: str
    detail: Mapping[str, Any]
    digest: str


@dataclass(frozen=True)
class AlarmRates(_Plain):
    """How many alarms were raised, after ANSI/ISA-18.2 clause 16: over ten in ten minutes are a
    flood for one operator.

    `highest_in_10_minutes` and `flood_share` are over the last day; `chattering` were raised three
    times within a minute, `stale` have been on the list for over a day, `standing` counts the
    alarms in each state.
    """

    last_10_minutes: int
    last_hour: int
    last_day: int
    highest_in_10_minutes: int
    flood: bool
    flood_share: float
    standing: Mapping[str, int]
    stale: Sequence[int]
    chattering: Sequence[int]
    most_frequent: Sequence[Mapping[str, Any]]


@dataclass(frozen=True)
class IndicatorHistory:
    """Indicators of the newest windows of an asset, oldest first; a row a finding, NaN where an
    indicator is absent.
    """

    at: Sequence[datetime]
    windows: Sequence[int]
    verdicts: Sequence[str]
    indicators: Mapping[str, Sequence[float | None]]
    thresholds: Mapping[str, Sequence[float | None]]
    units: Mapping[str, str]


@dataclass(frozen=True)
class FindingHour(_Plain):
    """One hour of findings whose rows were let go: windows, verdicts, and each indicator's n,
    minimum, maximum and mean.
    """

    hour: datetime
    windows: int
    verdicts: Mapping[str, int]
    indicators: Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class ModelVersion(_Plain):
    """One version of a stored model: `kind` is physical (YAML), identified (JSON) or baseline (a
    trained diagnoser).
    """

    model: str
    kind: str
    number: int
    created_at: datetime
    created_by: str | None
    note: str
    size_bytes: int
    checksum: str


@dataclass(frozen=True)
class StoredRecord(_Plain):
    """An uploaded record: what it holds; the samples are read apart."""

    id: int
    name: str
    created_at: datetime
    t0: float
    sample_time: float
    n: int
    units: Mapping[str, str]
    notes: Sequence[str]
    size_bytes: int
