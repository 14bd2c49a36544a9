"""Whether the rows of a database agree with each other: what no constraint says, and a hand or a damaged disk may break."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, func, select

from residuum.diagnosis.finding import Verdict
from residuum.service.alarms.alarm_states import AlarmState
from residuum.service.storage.rows.row_checksums import differs, finding_differs, window_differs
from residuum.service.storage.tables import (
    alarm_journal,
    alarms,
    assets,
    finding_hours,
    findings,
    model_versions,
    models,
    records,
    windows,
)

_AT_ONCE = 1000
_DOCUMENTS = ("indicators", "thresholds", "units", "evidence")


@dataclass(frozen=True)
class RowCheck:
    """How many rows were looked at, and what is wrong with some of them, a line each."""

    rows: int
    wrong: list[str]


def check_rows(connection: Connection, pause: float = 0.0) -> RowCheck:
    """Look at every window, finding, alarm, record and model; nothing is changed. `pause` [s] after every thousand of them.

    Only what holds for all of them at any moment is asked: each window has its finding and plausible numbers, each finding can be
    read and is of its window's asset, each asset points to its newest finding, each alarm's state is that of its newest entry in
    the journal, each model's versions are whole and counted.
    """
    wrong: list[str] = []
    rows = 0
    for look in (_windows, _findings, _assets, _alarms, _models, _sealed):
        for seen, says in look(connection):
            rows += seen
            if seen and rows % _AT_ONCE == 0:
                time.sleep(pause)
            if says is not None:
                wrong.append(says)
    return RowCheck(rows, wrong)


Seen = Iterator[tuple[int, str | None]]


def _windows(connection: Connection) -> Seen:
    judged = select(func.count()).where(findings.c.window_id == windows.c.id).correlate(windows).scalar_subquery()
    for row in _all(connection, select(windows, judged.label("judged")).order_by(windows.c.id)):
        yield 1, None
        if not row.judged:
            yield 0, f"window {row.id} of {row.asset_id!r} has no finding"
        if not (row.n > 0 and math.isfinite(row.sample_time) and row.sample_time > 0):
            yield 0, f"window {row.id} of {row.asset_id!r} has {row.n} samples every {row.sample_time} s"
        elif not isinstance(row.units, dict) or row.size_bytes < row.n * len(row.units):
            yield 0, f"window {row.id} of {row.asset_id!r}: {row.size_bytes} bytes cannot hold {row.n} samples of its signals"
        if window_differs(row._mapping):
            yield 0, f"window {row.id} of {row.asset_id!r}: its row differs from its checksum"


def _findings(connection: Connection) -> Seen:
    query = select(findings, windows.c.asset_id.label("of")).join_from(findings, windows, windows.c.id == findings.c.window_id)
    known = {verdict.value for verdict in Verdict}
    for row in _all(connection, query.order_by(findings.c.id)):
        yield 1, None
        if row.asset_id != row.of:
            yield 0, f"finding {row.id} is of {row.asset_id!r}, its window {row.window_id} of {row.of!r}"
        if row.verdict not in known:
            yield 0, f"finding {row.id} of {row.asset_id!r}: its verdict is {row.verdict!r}"
        if broken := next((name for name in _DOCUMENTS if not isinstance(getattr(row, name), dict)), None):
            yield 0, f"finding {row.id} of {row.asset_id!r}: its {broken} are no object of names to values"
        if finding_differs(row._mapping):
            yield 0, f"finding {row.id} of {row.asset_id!r}: its row differs from its checksum"


def _assets(connection: Connection) -> Seen:
    newest = select(func.max(findings.c.id)).where(findings.c.asset_id == assets.c.id).correlate(assets).scalar_subquery()
    held = select(func.count()).where(windows.c.asset_id == assets.c.id).correlate(assets).scalar_subquery()
    for row in _all(connection, select(assets, newest.label("newest"), held.label("held"))):
        yield 1, None
        if row.last_finding_id != row.newest:
            yield 0, f"asset {row.id!r}: its latest finding is said to be {row.last_finding_id} and is {row.newest}"
        if row.windows < row.held:
            yield 0, f"asset {row.id!r}: counts {row.windows} windows and has {row.held}"
        if differs(assets, row._mapping):
            yield 0, f"asset {row.id!r}: its row differs from its checksum"


def _alarms(connection: Connection) -> Seen:
    newest = select(func.max(alarm_journal.c.id)).where(alarm_journal.c.alarm_id == alarms.c.id).correlate(alarms)
    query = select(alarms, alarm_journal.c.state.label("written")).join_from(
        alarms, alarm_journal, alarm_journal.c.id == newest.scalar_subquery(), isouter=True
    )
    known = {state.value for state in AlarmState}
    for row in _all(connection, query):
        yield 1, None
        if row.state not in known:
            yield 0, f"alarm {row.id} of {row.asset_id!r}: its state is {row.state!r}"
        elif row.written is not None and row.written != row.state:
            yield 0, f"alarm {row.id} of {row.asset_id!r}: is {row.state}, and its journal ends with {row.written}"
        if differs(alarms, row._mapping):
            yield 0, f"alarm {row.id} of {row.asset_id!r}: its row differs from its checksum"


def _models(connection: Connection) -> Seen:
    for model in connection.execute(select(models)).all():
        if differs(models, model._mapping):
            yield 0, f"model {model.id!r}: its row differs from its checksum"
        numbers = []
        query = select(model_versions).where(model_versions.c.model_id == model.id).order_by(model_versions.c.number)
        for row in connection.execute(query.execution_options(yield_per=1)):
            yield 1, None
            numbers.append(row.number)
            if len(row.content) != row.size_bytes or hashlib.sha256(row.content).hexdigest() != row.checksum:
                yield 0, f"model {model.id!r}, version {row.number}: its content differs from its checksum"
            if differs(model_versions, row._mapping):
                yield 0, f"model {model.id!r}, version {row.number}: its row differs from its checksum"
        if numbers != list(range(1, model.last_number + 1)):
            yield 0, f"model {model.id!r}: has {len(numbers)} versions and counts {model.last_number}"


def _sealed(connection: Connection) -> Seen:
    for what, table in (
        ("entry {} of alarms' journal", alarm_journal),
        ("record {}", records),
        ("hour {1} of {0!r}", finding_hours),
    ):
        for row in _all(connection, select(table)):
            says = (
                f"{what.format(*(row._mapping[column.name] for column in table.primary_key))}: its row differs from its checksum"
            )
            yield 1, says if differs(table, row._mapping) else None


def _all(connection: Connection, query: Any) -> Iterator[Any]:
    """Every row; one that the database's driver cannot read ends it with ValueError, which names no row."""
    yield from connection.execute(query.execution_options(yield_per=_AT_ONCE))
