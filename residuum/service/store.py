"""What the service keeps, as values, and the interface through which the other parts of the service reach it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Any, Generic, Protocol, TypeVar

import numpy.typing as npt

from residuum.diagnosis.finding import Finding
from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.service.alarms.alarm_states import AlarmEvent, AlarmState


class NotFound(BadInput):
    """There is no such thing in the store; the message names it."""


class Conflict(BadInput):
    """The request contradicts what is stored (an idempotency key used twice for different windows, a name taken)."""


class SignalLetGo(BadInput):
    """The signal was removed by the retention rule; the window's row and findings are still there."""


class StorageUnavailable(Exception):
    """The disk or the database cannot take a write; `full` tells a full disk from a read-only or absent one."""

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


@dataclass(frozen=True)
class StoredFinding:
    """A finding with its place and time (UTC)."""

    id: int
    asset: str
    window: int
    at: datetime
    finding: Finding

    def to_json(self) -> dict[str, Any]:
        """The `score` object with where and when."""
        return {"id": self.id, "asset": self.asset, "window": self.window, "at": self.at, **self.finding.to_json()}


@dataclass(frozen=True)
class StoredWindow(_Plain):
    """One stored window: what it holds and where it came from; the samples are read apart.

    `t0` is the recorder's clock [s]; `signal_let_go_at` is when the retention rule removed the samples, None while they are kept.
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
    """A stored record whose samples are read piece by piece: a long signal is never held as a whole.

    `pieces(name)` gives a channel's samples in their order. What is damaged shows at the end, as an exception instead of an end:
    what was made of the pieces before is not to be answered with then.
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
        """The asset; `state` is the latest verdict, `no-baseline` while windows are only recorded, or `no-data`."""
        last = self.last_finding
        verdict = None if last is None else "no-baseline" if last.finding.only_recorded else last.finding.verdict.value
        return {
            "id": self.id,
            "title": self.title,
            "diagnoser": self.diagnoser,
            "created_at": self.created_at,
            "windows": self.windows,
            "state": verdict or "no-data",
            "last_finding": last.to_json() if last else None,
        }


@dataclass(frozen=True)
class Alarm(_Plain):
    """One alarm of one asset. `kind` tells a fault of the machine from one of its signals.

    `message` and `window` are of the worst finding since the alarm was raised, which is of `worst_at`.
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
    """One time that an alarm was raised, with what raised it and what became of it; `cleared_at` is None while it stands.

    `message`, `times_threshold` (the largest indicator over its threshold) and `window` are those of the finding that raised it;
    None where its row was let go.
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
    """How many alarms were raised, after ANSI/ISA-18.2 clause 16: over ten in ten minutes are a flood for one operator.

    `highest_in_10_minutes` and `flood_share` are over the last day; `chattering` were raised three times within a minute,
    `stale` have been on the list for over a day, `standing` counts the alarms in each state.
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
    """Indicators of the newest windows of an asset, oldest first; a row a finding, NaN where an indicator is absent."""

    at: Sequence[datetime]
    windows: Sequence[int]
    verdicts: Sequence[str]
    indicators: Mapping[str, Sequence[float | None]]
    thresholds: Mapping[str, Sequence[float | None]]
    units: Mapping[str, str]


@dataclass(frozen=True)
class FindingHour(_Plain):
    """One hour of findings whose rows were let go: windows, verdicts, and each indicator's n, minimum, maximum and mean."""

    hour: datetime
    windows: int
    verdicts: Mapping[str, int]
    indicators: Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class ModelVersion(_Plain):
    """One version of a stored model: `kind` is physical (YAML), identified (JSON) or baseline (a trained diagnoser)."""

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


class Store(Protocol):
    """Everything that outlives a run of the service. All methods are thread-safe and block until they are done."""

    def add_window(
        self, asset: str, record: Record, finding: Finding, idempotency_key: str | None = None, digest: str | None = None
    ) -> int:
        """Keep a window and its finding; returns the window's id only when both are on disk."""

    def window_with_key(self, asset: str, idempotency_key: str, digest: str) -> int | None:
        """The window stored under a key before, None when there is none; Conflict when its content differed."""

    def ensure_asset(self, asset: str, title: str | None = None, diagnoser: str | None = None) -> None:
        """Make an asset known, or update its title and diagnoser."""

    def assets(self, cursor: str | None = None, limit: int = 100, sites: Collection[str] | None = None) -> Page[Asset]:
        """Assets by name, of some sites or of all."""

    def asset(self, asset: str) -> Asset:
        """One asset."""

    def findings(self, asset: str, cursor: str | None = None, limit: int = 50, verdict: str | None = None) -> Page[StoredFinding]:
        """Findings of an asset, newest first."""

    def findings_after(self, asset: str, number: int, limit: int = 100) -> Sequence[StoredFinding]:
        """The first findings of an asset that come after a number, oldest first; none for an asset that is not known."""

    def newest_finding(self) -> int:
        """The largest number of a finding; 0 before there is one."""

    def findings_between(
        self, asset: str, begin: datetime, end: datetime, after: int = 0, limit: int = 500
    ) -> Sequence[StoredFinding]:
        """The first findings of an asset in [begin, end) with a number larger than `after`, oldest first."""

    def windows_between(
        self, asset: str, begin: datetime, end: datetime, after: int = 0, limit: int = 500
    ) -> Sequence[StoredWindow]:
        """The first windows of an asset received in [begin, end) with a number larger than `after`, oldest first."""

    def finding_of(self, window: int) -> StoredFinding:
        """The latest finding on a window."""

    def indicators(
        self, asset: str, limit: int = 500, span: tuple[datetime | None, datetime | None] | None = None
    ) -> IndicatorHistory:
        """Indicators and thresholds of the newest findings, or of at most so many spread over a span of time (None: open)."""

    def finding_hours(self, asset: str, limit: int = 24 * 30) -> Sequence[FindingHour]:
        """Hourly history of the findings whose rows were let go."""

    def recorded_windows(self, asset: str, limit: int = 500) -> Sequence[int]:
        """The newest windows of an asset that are kept with their signals and were never judged, oldest first."""

    def windows(self, asset: str, cursor: str | None = None, limit: int = 50) -> Page[StoredWindow]:
        """Windows of an asset, newest first."""

    def window(self, asset: str, window: int) -> StoredWindow:
        """One window."""

    def window_record(self, asset: str, window: int, channels: Sequence[str] | None = None) -> Record:
        """The samples of a window; SignalLetGo when the retention rule has removed them."""

    def window_in_pieces(self, asset: str, window: int, channels: Sequence[str] | None = None) -> ReadInPieces:
        """The same, to be read piece by piece."""

    def alarms(
        self,
        asset: str | None = None,
        active: bool = True,
        cursor: str | None = None,
        limit: int = 100,
        sites: Collection[str] | None = None,
    ) -> Page[Alarm]:
        """Alarms of some sites or of all, the newest occurrence first."""

    def alarms_changed(self, asset: str, moments: Collection[datetime]) -> Sequence[Alarm]:
        """The alarms of an asset, as they are now, that changed with the findings of these moments."""

    def alarm(self, alarm: int) -> Alarm:
        """One alarm."""

    def alarm_journal(self, alarm: int, limit: int = 100) -> Sequence[AlarmEntry]:
        """What happened to an alarm, newest first."""

    def alarm_history(
        self,
        span: tuple[datetime | None, datetime | None] = (None, None),
        asset: str | None = None,
        cursor: str | None = None,
        limit: int = 100,
        sites: Collection[str] | None = None,
    ) -> Page[AlarmOccurrence]:
        """Alarms that were raised in a span of time (None: open), the newest first, each with what became of it."""

    def operate_alarm(
        self, alarm: int, event: AlarmEvent, by: str | None = None, comment: str | None = None, until: datetime | None = None
    ) -> Alarm:
        """What an operator asks of an alarm."""

    def alarm_rates(self) -> AlarmRates:
        """How many alarms were raised of late."""

    def audit(self, cursor: str | None = None, limit: int = 100) -> Page[AuditEntry]:
        """The audit trail, newest first."""

    def add_record(self, name: str, record: Record) -> int:
        """Keep an uploaded record; returns its id when it is on disk."""

    def records(self, cursor: str | None = None, limit: int = 50) -> Page[StoredRecord]:
        """Uploaded records, newest first."""

    def record(self, record: int) -> StoredRecord:
        """One uploaded record."""

    def record_samples(self, record: int, channels: Sequence[str] | None = None) -> Record:
        """The samples of an uploaded record."""

    def record_in_pieces(self, record: int, channels: Sequence[str] | None = None) -> ReadInPieces:
        """The same, to be read piece by piece."""

    def remove_record(self, record: int, by: str | None = None) -> None:
        """Delete an uploaded record for good; NotFound when there is none."""

    def add_model_version(self, model: str, kind: str, content: bytes, note: str = "", by: str | None = None) -> ModelVersion:
        """Keep a new version of a model; the first makes the model.

        A trained diagnoser is kept as kind `baseline` under its asset's name: windows of that asset are then judged by it.
        """

    def models(self, kind: str | None = None, cursor: str | None = None, limit: int = 100) -> Page[ModelVersion]:
        """The newest version of every model, by name."""

    def model_versions(self, model: str) -> Sequence[ModelVersion]:
        """All versions of a model, newest first."""

    def model_content(self, model: str, number: int | None = None) -> bytes:
        """The file of one version (default: the newest)."""

    def check(self) -> None:
        """Raise StorageUnavailable when a small window could not be stored now."""

    def troubles(self) -> Mapping[str, str]:
        """What storing suffers from although windows are taken, by its subject; empty where nothing is wrong."""

    def unshelve_expired(self) -> None:
        """Put alarms back whose shelving has run out."""
