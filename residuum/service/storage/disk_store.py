"""The store on disk: rows in a database, signals in blocks, joined so that what was acknowledged is
there after a crash.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from functools import wraps
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar

from sqlalchemy import Connection, Row
from sqlalchemy.exc import IntegrityError

from residuum.diagnosis.finding import Finding
from residuum.identification.errors import in_one_line
from residuum.identification.record import Record
from residuum.service.alarms.alarm_states import AlarmEvent, AlarmRule
from residuum.service.alarms.machine_states import UntoldStates, suppressing_state
from residuum.service.storage import audit as audit_trail
from residuum.service.storage import retention
from residuum.service.storage.blocks import BlockReference, Blocks, BrokenBlock
from residuum.service.storage.database import Busy, Database, OutcomeUnknown, SamePlace, sqlite_file
from residuum.service.storage.outbox import Outbox
from residuum.service.storage.retention import Clock, Retention
from residuum.service.storage.rows import alarm_floods, block_rows, finding_notices
from residuum.service.storage.rows import alarm_history as alarm_occurrences
from residuum.service.storage.rows import alarms as alarm_rows
from residuum.service.storage.rows import assets as asset_rows
from residuum.service.storage.rows import confirmations as confirmation_rows
from residuum.service.storage.rows import finding_hours as finding_hour_rows
from residuum.service.storage.rows import models as model_rows
from residuum.service.storage.rows import records as record_rows
from residuum.service.storage.rows import windows as window_rows
from residuum.service.storage.rows.row_checks import check_rows
from residuum.service.store import (
    Alarm,
    AlarmRates,
    Confirmation,
    FoundAtMachine,
    ModelVersion,
    ReadInPieces,
    SignalLetGo,
    StorageUnavailable,
    StoredFinding,
)

SETTLED = 120.0
"""Age [s] at which a block without a row is an orphan: longer than a writer waits for the
database.
"""

# Seconds for which who asks meanwhile waits for what another look finds; then readiness is denied,
# for it must be answered also where the database says nothing.
_CHECK_WITHIN = 2.0
# Seconds between looks at whether something can be stored: each writes to the disk, and anybody may
# ask for one.
_CHECK_EVERY = 1.0
# Pause [s] after every thousand rows that are looked at, in which requests are answered.
_BETWEEN_ROWS = 0.1
# [s] Of window times that are taken for a clock: from the year 2000 to 9999; others count from some
# start.
_FIRST_CLOCK, _LAST_CLOCK = 946_684_800.0, 253_402_300_000.0
# By how much a window's own clock may be ahead of ours to be believed.
_AHEAD = timedelta(minutes=1)

P = ParamSpec("P")
Answer = TypeVar("Answer")

Announce = Callable[[str, Mapping[str, Any]], None]
"""Told what changed, after it is on disk: (event kind, payload)."""


def _silent(_kind: str, _payload: Mapping[str, Any]) -> None:
    """Announce to nobody."""


def _plain(_asset: str) -> AlarmRule:
    """No deadband, no delay, no latch."""
    return AlarmRule()


def _asked(
    rows: Callable[Concatenate[Connection, P], Answer],
) -> Callable[Concatenate[DiskStore, P], Answer]:
    """A question of the store that its rows answer in one read: their signature and their words are
    the method's.
    """

    @wraps(rows)
    def method(self: DiskStore, /, *given: P.args, **named: P.kwargs) -> Answer:
        with self._database.read() as connection:
            return rows(connection, *given, **named)

    return method


class DiskStore:
    """Everything that outlives a run of the service, in a folder and a database.

    All methods are thread-safe and block until they are done. What is only read is asked of the
    rows as it stands there.

    Order of a write: the signal block, fsync of file and folder, then one transaction with the rows
    (window, finding, asset, alarms); only after its commit does the call return and the change get
    announced. A crash in between leaves at most a block without a row, which `sweep` removes.

    Parameters
    ----------
    data : Path
        Folder of the signal blocks (`data/blocks`).
    database_url : str
        SQLAlchemy URL; the schema is brought up to date at once.
    announce : callable
        Called as `announce(kind, payload)` after every commit that listeners care about.
    rule_of : callable
        Gives the alarm rule of an asset.
    """

    def __init__(
        self,
        data: Path,
        database_url: str,
        announce: Announce = _silent,
        rule_of: Callable[[str], AlarmRule] = _plain,
    ) -> None:
        self._database = Database(database_url)
        self._database.migrate()
        self.outbox = Outbox(self._database)
        self._blocks = Blocks(data / "blocks")
        self._clock = Clock()
        self.damage: str | None = None
        # After the migration, which begins the database's file: known is what this run has opened.
        self._place = SamePlace(self._blocks.folder, sqlite_file(database_url))
        self._announce = announce
        self._rule_of = rule_of
        self.untold_states = UntoldStates()
        self._checking, self._checked_at = threading.Lock(), -math.inf
        self._refusal: StorageUnavailable | None = None

    assets = _asked(confirmation_rows.assets_page)
    asset = _asked(confirmation_rows.asset_of)
    findings = _asked(confirmation_rows.findings_page)
    findings_after = _asked(asset_rows.findings_after)
    findings_between = _asked(asset_rows.findings_between)
    windows_between = _asked(window_rows.between)
    newest_finding = _asked(asset_rows.newest_finding)
    finding_of = _asked(confirmation_rows.finding_of)
    confirmations = _asked(confirmation_rows.page)
    standing_confirmations = _asked(confirmation_rows.standing)
    indicators = _asked(asset_rows.indicators)
    finding_hours = _asked(finding_hour_rows.newest)
    recorded_windows = _asked(asset_rows.recorded_windows)
    windows = _asked(window_rows.page)
    window = _asked(window_rows.get)
    alarms = _asked(alarm_rows.page)
    alarms_changed = _asked(alarm_rows.changed_at)
    alarm = _asked(alarm_rows.get)
    alarm_journal = _asked(alarm_rows.journal)
    alarm_history = _asked(alarm_occurrences.page)
    audit = _asked(audit_trail.page)
    records = _asked(record_rows.page)
    record = _asked(record_rows.get)
    models = _asked(model_rows.page)
    model_versions = _asked(model_rows.versions)
    model_content = _asked(model_rows.content)

    def close(self) -> None:
        """Close the database."""
        self._database.close()

    def check(self) -> None:
        """Raise StorageUnavailable when a small window could not be stored now: a block and a row
        are written.

        At most once a second, however many ask: what was found then is what they are told.
        """
        self._place.check()
        if not self._checking.acquire(timeout=_CHECK_WITHIN):
            raise Busy(
                f"database: has not answered for {_CHECK_WITHIN:g} s whether it can be written"
            )
        try:
            # Whoever waited for the lock meanwhile gets the answer of the look that it waited for.
            if time.monotonic() - self._checked_at >= _CHECK_EVERY:
                self._refusal = self._looked()
                self._checked_at = time.monotonic()
            if self._refusal is not None:
                raise StorageUnavailable(str(self._refusal), full=self._refusal.full)
        finally:
            self._checking.release()

    def _looked(self) -> StorageUnavailable | None:
        try:
            self._blocks.probe()
            with self._database.write() as connection:
                audit_trail.touch(connection)
        except StorageUnavailable as error:
            return error
        return None

    def unshelve_expired(self) -> None:
        """Put alarms back whose shelving has run out, and tell of a flood that is over."""
        with self._database.write() as connection:
            # First, so that the notice of a flood's end has them as they are then.
            expired = alarm_rows.unshelve_expired(connection, _now())
            alarm_floods.end(connection, _now())
        for alarm in expired:
            self._announce("alarm", alarm.to_json())

    def add_window(
        self,
        asset: str,
        record: Record,
        finding: Finding,
        idempotency_key: str | None = None,
        digest: str | None = None,
    ) -> int:
        """Keep a window and its finding; returns the window's id only when both are on disk.

        A second call with the same `idempotency_key` stores nothing and returns the first one's id;
        Conflict when its `digest` (of the content) differs.
        """
        now = _now()
        with self._noted():
            request = window_rows.RequestKey(idempotency_key, digest)
            known = self._known_window(asset, request)
            if known is not None:
                return known
            self._place.check()
            block = self._blocks.write(record, _day(now))
            try:
                with self._discarded_on_failure(block):
                    return self._add_rows(asset, record, finding, block, now, request)
            except IntegrityError:  # another request with the same key was faster
                known = self._known_window(asset, request)
                if known is None:
                    raise
                return known

    @contextmanager
    def _discarded_on_failure(self, block: BlockReference) -> Iterator[None]:
        """Discard a block whose row could not be written; one whose row may be there stays, and who
        asks again finds out.
        """
        try:
            yield
        except OutcomeUnknown:
            raise
        except BaseException:
            self._blocks.discard(block.path)
            raise

    @contextmanager
    def _noted(self) -> Iterator[None]:
        """Let `check` look again at once when a write shows that what it found holds no more."""
        try:
            yield
        except StorageUnavailable:
            if self._refusal is None:
                self._checked_at = -math.inf
            raise
        if self._refusal is not None:
            self._checked_at = -math.inf

    def _refuse_moved(self) -> None:
        """OutcomeUnknown when what was just committed is not in what the next start opens: it is
        not acknowledged.
        """
        try:
            self._place.check()
        except StorageUnavailable as error:
            raise OutcomeUnknown(str(error)) from None

    def _add_rows(
        self,
        asset: str,
        record: Record,
        finding: Finding,
        block: BlockReference,
        now: datetime,
        request: window_rows.RequestKey,
    ) -> int:
        with self._database.write() as connection:
            asset_rows.ensure(connection, asset, None, finding.diagnoser, now)
            window = window_rows.add(connection, asset, record, block, now, request)
            number = asset_rows.add_finding(connection, asset, window, finding, now)
            finding_notices.add(connection, number)
            # Alarms and their notices in the window's own transaction: a process that dies in
            # between has kept both or neither (docs/decisions/0014).
            rule = self._rule_of(asset)
            judged = alarm_rows.JudgedWindow(
                window,
                finding,
                rule,
                now,
                seen_at=_seen_at(record, now),
                suppressing_state=suppressing_state(rule, record),
            )
            changed = alarm_rows.follow(connection, asset, judged)
        self._refuse_moved()
        self.untold_states.note(asset, rule, record)
        # After the commit: a page that hears of it reads the rows at once, and must find them.
        self._announce("finding", StoredFinding(number, asset, window, now, finding).to_json())
        for alarm in changed:
            self._announce("alarm", alarm.to_json())
        return window

    def window_with_key(self, asset: str, idempotency_key: str, digest: str | None) -> int | None:
        """The window stored under a key before, None when there is none; Conflict when its content
        differed.
        """
        return self._known_window(asset, window_rows.RequestKey(idempotency_key, digest))

    def _known_window(self, asset: str, request: window_rows.RequestKey) -> int | None:
        if request.key is None:
            return None
        # A window of a database that was moved away is not stored: who sends it again must not
        # be told that it is.
        self._place.check()
        with self._database.read() as connection:
            return window_rows.with_key(connection, asset, request)

    def ensure_asset(
        self, asset: str, title: str | None = None, diagnoser: str | None = None
    ) -> None:
        """Make an asset known, or update its title and diagnoser."""
        with self._database.write() as connection:
            asset_rows.ensure(connection, asset, title, diagnoser, _now())

    def window_record(
        self, asset: str, window: int, channels: Sequence[str] | None = None
    ) -> Record:
        """The samples of a window (of some channels), verified; SignalLetGo when the retention rule
        has removed them.
        """
        with self._let_go_meanwhile(asset, window) as row:
            return self._blocks.read(row.block_path, channels, row.block_checksum)

    def window_in_pieces(
        self, asset: str, window: int, channels: Sequence[str] | None = None
    ) -> ReadInPieces:
        """The same, to be read piece by piece."""
        with self._let_go_meanwhile(asset, window) as row:
            return self._blocks.in_pieces(row.block_path, channels, row.block_checksum)

    @contextmanager
    def _let_go_meanwhile(self, asset: str, window: int) -> Iterator[Row[Any]]:
        """The row of a window whose signal is kept; SignalLetGo also where it goes while its block
        is read.
        """
        row = self._held(asset, window)
        try:
            yield row
        except BrokenBlock:
            self._held(asset, window)
            raise

    def _held(self, asset: str, window: int) -> Row[Any]:
        with self._database.read() as connection:
            row = window_rows.row_of(connection, asset, window)
        if row.signal_let_go_at is not None:
            let_go_at = row.signal_let_go_at.isoformat(" ", "seconds")
            raise SignalLetGo(
                f"asset {asset!r}, window {window}: its signal was let go at {let_go_at} by the"
                " retention rule"
            )
        return row

    def operate_alarm(
        self,
        alarm: int,
        event: AlarmEvent,
        by: str | None = None,
        comment: str | None = None,
        until: datetime | None = None,
    ) -> Alarm:
        """What an operator asks of an alarm; IllegalTransition when its state does not allow it."""
        with self._database.write() as connection:
            note = alarm_rows.JournalNote(event, _now(), by, comment)
            changed = alarm_rows.operate(connection, alarm, note, until)
        self._announce("alarm", changed.to_json())
        return changed

    def note_order(self, alarm: int, number: str, receiver: str) -> None:
        """Keep the number of the work order that a receiver made of an alarm."""
        with self._database.write() as connection:
            alarm_rows.note_order(connection, alarm, number, receiver, _now())

    def confirm(
        self, asset: str, finding: int, observed: FoundAtMachine, by: str | None = None
    ) -> Confirmation:
        """Keep what was found at the machine of what a finding said; BadInput where it contradicts
        itself.
        """
        with self._database.write() as connection:
            confirmation = confirmation_rows.add(
                connection, asset, finding, observed, by=by, now=_now()
            )
        self._announce("confirmation", confirmation.to_json())
        return confirmation

    def alarm_rates(self) -> AlarmRates:
        """How many alarms were raised of late."""
        with self._database.read() as connection:
            return retention.rates(connection, _now())

    def add_record(self, name: str, record: Record) -> int:
        """Keep an uploaded record; returns its id when it is on disk."""
        now = _now()
        self._place.check()
        block = self._blocks.write(record, _day(now))
        with self._discarded_on_failure(block):
            with self._database.write() as connection:
                number = record_rows.add(connection, name, record, block, now)
            self._refuse_moved()
            return number

    def record_samples(self, record: int, channels: Sequence[str] | None = None) -> Record:
        """The samples of an uploaded record, verified."""
        with self._database.read() as connection:
            row = record_rows.row_of(connection, record)
        return self._blocks.read(row.block_path, channels, row.block_checksum)

    def record_in_pieces(self, record: int, channels: Sequence[str] | None = None) -> ReadInPieces:
        """The same, to be read piece by piece."""
        with self._database.read() as connection:
            row = record_rows.row_of(connection, record)
        return self._blocks.in_pieces(row.block_path, channels, row.block_checksum)

    def audit_refusals(self, refusals: Sequence[tuple[Mapping[str, Any], int]]) -> None:
        """Note in the trail what was refused: address, name of the key, method, path and status of
        each, and how often.
        """
        now = _now()
        with self._database.write() as connection:
            for refusal, times in refusals:
                subject = f"{refusal['method']} {refusal['path']}"
                detail = {
                    "address": refusal["address"],
                    "status": refusal["status"],
                    "times": times,
                }
                audit_trail.append(
                    connection, "refused", subject, by=refusal["by"], now=now, detail=detail
                )

    def remove_record(self, record: int, by: str | None = None) -> None:
        """Delete an uploaded record for good: its row first, so that a crash leaves at most an
        orphan for `sweep`.
        """
        with self._database.write() as connection:
            row = record_rows.row_of(connection, record)
            path = record_rows.remove(connection, record)
            detail = {"name": row.name, "checksum": row.block_checksum}
            audit_trail.append(
                connection, "record removed", f"record {record}", by=by, now=_now(), detail=detail
            )
        self._blocks.remove(path)

    def add_model_version(
        self, model: str, kind: str, content: bytes, note: str = "", by: str | None = None
    ) -> ModelVersion:
        """Keep a new version of a model; the first makes the model."""
        with self._database.write() as connection:
            new = model_rows.NewVersion(model, kind, content, note, by)
            version = model_rows.add_version(connection, new, _now())
            detail = {"kind": kind, "number": version.number, "checksum": version.checksum}
            audit_trail.append(
                connection,
                "model version",
                f"model {model}",
                by=by,
                now=version.created_at,
                detail=detail,
            )
        self._announce("model", version.to_json())
        return version

    def retain(self, rule: Retention) -> int:
        """Remove the signals, and then the rows, that the retention rule no longer keeps; returns
        how many signals.

        The rows say so before the files go: a crash in between leaves files that `sweep` removes.
        """
        count, self._clock.doubt = 0, None
        while True:
            with self._database.patiently(), self._database.write() as connection:
                # A batch a transaction: writers wait for one, not for all that goes. The trail
                # tells what the service itself lets go, as it tells what somebody deletes.
                paths = retention.let_go(connection, rule, _now(), self._clock)
                if paths:
                    audit_trail.append(
                        connection,
                        "signals let go",
                        "windows",
                        by=None,
                        now=_now(),
                        detail={"windows": len(paths)},
                    )
            for path in paths:
                self._blocks.remove(path)
            count += len(paths)
            if not paths:
                break
        while self._forget(rule):
            pass
        return count

    def _forget(self, rule: Retention) -> int:
        with self._database.patiently(), self._database.write() as connection:
            count = retention.forget(connection, rule, _now(), self._clock)
            if count:
                audit_trail.append(
                    connection,
                    "rows let go",
                    "windows",
                    by=None,
                    now=_now(),
                    detail={"windows": count},
                )
            return count

    def troubles(self) -> Mapping[str, str]:
        """What storing suffers from although windows are taken, by its subject."""
        doubts = {"retention": self._clock.doubt, "database": self.damage}
        return {subject: says for subject, says in doubts.items() if says is not None}

    def look_for_damage(self) -> str | None:
        """Read what a start has not of a SQLite database for damage, which may take minutes; what
        is found is kept in `damage`.

        The structure of a large file, then each row: a value that flipped where rows are chosen by
        it may leave a row out of an answer.
        """
        self.damage = None if self._database.looked_through_first() else self._database.damage()
        if self.damage is None:
            self.damage = self._damaged_rows()
        return self.damage

    def _damaged_rows(self) -> str | None:
        try:
            with self._database.read() as connection:
                wrong = check_rows(connection, pause=_BETWEEN_ROWS).wrong
        except ValueError as error:
            return f"a row cannot be read: {in_one_line(error)}"
        return f"{wrong[0]} ({len(wrong)} in all; `residuum doctor` names them)" if wrong else None

    def orphans(self, settled: float = 0.0) -> set[str]:
        """Blocks that no row points to (left by a crash) and that are older than `settled` seconds.

        While something else may be writing, `settled` must exceed the time from a block to its row.
        """
        # The blocks first: one whose row comes between the two looks is then known.
        paths = set(self._blocks.paths(settled))
        with self._database.read() as connection:
            return paths - {block.path for block in block_rows.references(connection)}

    def sweep(self, settled: float = 0.0) -> int:
        """Remove the orphans, for good; returns how many. Only when somebody asks: beside another
        database all would be.
        """
        orphans = self.orphans(settled)
        for path in orphans:
            self._blocks.remove(path)
        if orphans:
            with self._database.write() as connection:
                detail = {"blocks": len(orphans)}
                audit_trail.append(
                    connection, "blocks swept", "signal blocks", by=None, now=_now(), detail=detail
                )
        return len(orphans)


def _seen_at(record: Record, now: datetime) -> datetime:
    """When a window ended by its own clock, where that is one: windows that a gateway sends late
    were not all seen at once.
    """
    end = record.t0 + record.n * record.sample_time
    own = (
        datetime.fromtimestamp(end, UTC) if record.t0 > _FIRST_CLOCK and end < _LAST_CLOCK else now
    )
    return own if own <= now + _AHEAD else now


def _now() -> datetime:
    return datetime.now(UTC)


def _day(moment: datetime) -> str:
    return moment.strftime("%Y-%m-%d")
