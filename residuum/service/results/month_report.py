"""What happened at a machine in a month: windows and verdicts by day, faults, alarms, indicators
and parameters over time.

Findings whose rows were let go are counted from their hours; their indicators then count with the
hour's mean and last limit.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Any

from residuum.service.results.parquet_tables import Span, findings_in, month_of
from residuum.service.storage.disk_store import DiskStore
from residuum.service.store import Alarm, AlarmEntry, Asset, Confirmation, StoredFinding

# Hours of a machine that are looked through: ten years of them.
_HOURS = 24 * 366 * 10
# Entries of an alarm's journal, the newest.
_JOURNAL = 10_000


@dataclass
class Followed:
    """A number over the month: when, its value, and the limit (for a parameter the healthy band)
    that held then.
    """

    unit: str
    at: list[datetime] = field(default_factory=list)
    value: list[float] = field(default_factory=list)
    low: list[float] = field(default_factory=list)
    high: list[float] = field(default_factory=list)

    def append(self, at: datetime, value: Any, low: Any, high: Any) -> None:
        """Add a moment; what is None is NaN."""
        self.at.append(at)
        for numbers, number in ((self.value, value), (self.low, low), (self.high, high)):
            numbers.append(float("nan") if number is None else float(number))


@dataclass
class Fault:
    """One kind of finding that says faulty."""

    says: str
    windows: int
    first: datetime
    last: datetime


@dataclass(frozen=True)
class MonthReport:
    """The facts of a report.

    `days` has a count of every verdict for each day of the month; `reasons` why windows could not
    be judged, with their number. `answered` is what was found at the machine of the month's
    findings, `plant` the same of all machines until the month's end.
    """

    asset: Asset
    month: str
    span: Span
    days: Sequence[Mapping[str, int]]
    faults: Mapping[str, Fault]
    reasons: Sequence[tuple[str, int]]
    alarms: Sequence[tuple[Alarm, Sequence[AlarmEntry]]]
    indicators: Mapping[str, Followed]
    parameters: Mapping[str, Followed]
    answered: Sequence[Confirmation] = ()
    plant: Sequence[Confirmation] = ()

    @property
    def verdicts(self) -> Mapping[str, int]:
        """Windows by verdict, over the month."""
        return sum((Counter(day) for day in self.days), Counter())


def month_report(
    store: DiskStore, asset: str, month: str, sites: Collection[str] | None = None
) -> MonthReport:
    """The report of a month `YYYY-MM` (UTC); of other machines it counts those of the sites (None:
    all).

    Raises
    ------
    NotFound
        An asset that is not there.
    BadInput
        What is no month.
    """
    span = month_of(month)
    known = store.asset(asset)
    days: list[Counter[str]] = [Counter() for _ in range((span.end - span.begin).days)]
    indicators: dict[str, Followed] = {}
    parameters: dict[str, Followed] = {}
    faults: dict[str, Fault] = {}
    reasons: Counter[str] = Counter()
    # an hour counts what was let go, a finding what is kept: no window is in both
    for hour in store.finding_hours(asset, _HOURS):
        if span.begin <= hour.hour < span.end:
            days[(hour.hour - span.begin).days].update(hour.verdicts)
            _add_hour(indicators, hour.hour, hour.indicators)
    for stored in findings_in(store, asset, span):
        verdict = stored.finding.verdict.value
        days[(stored.at - span.begin).days][verdict] += 1
        _add_finding(indicators, parameters, stored)
        if verdict == "faulty":
            _add_fault(faults, stored)
        elif verdict == "not-assessable":
            reasons[stored.finding.reason or "no reason given"] += 1
    alarms = list(_alarms_in(store, asset, span))
    return MonthReport(
        known,
        month,
        span,
        days,
        faults,
        reasons.most_common(5),
        alarms,
        indicators,
        parameters,
        store.standing_confirmations(span, asset),
        store.standing_confirmations((None, span.end), None, sites),
    )


def _add_hour(
    indicators: dict[str, Followed], hour: datetime, means: Mapping[str, Mapping[str, Any]]
) -> None:
    for name, entry in means.items():
        followed = indicators.setdefault(name, Followed(""))
        followed.unit = followed.unit or str(entry.get("unit") or "")
        # a mean of an hour stands in its middle
        followed.append(
            hour + timedelta(minutes=30), entry.get("mean"), None, entry.get("threshold")
        )


def _add_finding(
    indicators: dict[str, Followed], parameters: dict[str, Followed], stored: StoredFinding
) -> None:
    finding = stored.finding
    for name, value in finding.indicators.items():
        unit = finding.units.get(name, "")
        followed = indicators.setdefault(name, Followed(unit))
        followed.unit = followed.unit or unit
        followed.append(stored.at, value, None, finding.thresholds.get(name))
    # of diagnosers that watch by a model; others have no parameters in their evidence
    for name, estimate in dict(finding.evidence.get("parameters") or {}).items():
        band = estimate.get("healthy") or {}
        followed = parameters.setdefault(name, Followed(str(estimate.get("unit") or "")))
        followed.append(stored.at, estimate.get("value"), band.get("low"), band.get("high"))


def _add_fault(faults: dict[str, Fault], stored: StoredFinding) -> None:
    causes = stored.finding.evidence.get("causes") or []
    name = stored.finding.statement.says
    says = str(causes[0]["says"]) if causes else stored.finding.reason or ""
    # findings come oldest first: what the last one says is kept
    before = faults.get(name)
    faults[name] = Fault(
        says,
        (before.windows if before else 0) + 1,
        before.first if before else stored.at,
        stored.at,
    )


def _alarms_in(
    store: DiskStore, asset: str, span: Span
) -> Iterable[tuple[Alarm, Sequence[AlarmEntry]]]:
    """Alarms of the asset to which something happened in the month, with what, oldest first."""
    for alarm in store.alarms(asset, active=False).items:
        entries = [
            e for e in store.alarm_journal(alarm.id, _JOURNAL) if span.begin <= e.at < span.end
        ]
        # the journal has the newest first, a report is read from the begin
        if entries:
            yield alarm, entries[::-1]
