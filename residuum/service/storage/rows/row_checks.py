"""Whether the rows of a database agree with each other: what no constraint says, and a hand or a damaged disk may break."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, ScalarSelect, Select, Table, func, select

from residuum.diagnosis.finding import Verdict
from residuum.service.alarms.alarm_states import AlarmState
from residuum.service.storage.rows.row_checksums import SEALED, differs
from residuum.service.storage.tables import alarm_journal, alarms, assets, findings, model_versions, models, windows

_AT_ONCE = 1000
_DOCUMENTS = ("indicators", "thresholds", "units", "evidence")


@dataclass(frozen=True)
class RowCheck:
    """How many rows were looked at, and what is wrong with some of them, a line each."""

    rows: int
    wrong: list[str]


def check_rows(connection: Connection, pause: float = 0.0) -> RowCheck:
    """Look at every row that has a checksum; nothing is changed. `pause` [s] after every thousand of them.

    Beside the checksum only what holds for all of them at any moment is asked: each window has its finding and plausible numbers,
    each finding can be read and is of its window's asset, each asset points to its newest finding, each alarm's state is that of
    its newest entry in the journal, each model's versions are whole and counted.

    Raises ValueError for a row that the database's driver cannot read, which names no row.
    """
    wrong: list[str] = []
    rows = 0
    for table, (_, name) in SEALED.items():
        query, ask = _MORE.get(table, (select(table), None))
        at_once = 1 if table is model_versions else _AT_ONCE  # they hold whole files
        for row in connection.execute(query.execution_options(yield_per=at_once)):
            rows += 1
            if rows % _AT_ONCE == 0:
                time.sleep(pause)
            says = list(ask(row)) if ask else []
            if differs(table, row._mapping):
                says.append("its row differs from its checksum")
            wrong += (f"{name.format_map(row._mapping)}: {each}" for each in says)
    return RowCheck(rows, wrong)


Says = Iterator[str]


def _window(row: Row[Any]) -> Says:
    if not row.judged:
        yield "has no finding"
    if not (row.n > 0 and math.isfinite(row.sample_time) and row.sample_time > 0):
        yield f"has {row.n} samples every {row.sample_time} s"
    elif not isinstance(row.units, dict) or row.size_bytes < row.n * len(row.units):
        yield f"{row.size_bytes} bytes cannot hold {row.n} samples of its signals"


def _finding(row: Row[Any]) -> Says:
    if row.asset_id != row.of:
        yield f"its window {row.window_id} is of {row.of!r}"
    if row.verdict not in list(Verdict):
        yield f"its verdict is {row.verdict!r}"
    if broken := next((name for name in _DOCUMENTS if not isinstance(getattr(row, name), dict)), None):
        yield f"its {broken} are no object of names to values"


def _asset(row: Row[Any]) -> Says:
    if row.last_finding_id != row.newest:
        yield f"its latest finding is said to be {row.last_finding_id} and is {row.newest}"
    if row.windows < row.held:
        yield f"counts {row.windows} windows and has {row.held}"


def _alarm(row: Row[Any]) -> Says:
    if row.state not in list(AlarmState):
        yield f"its state is {row.state!r}"
    elif row.written is not None and row.written != row.state:
        yield f"is {row.state}, and its journal ends with {row.written}"


def _model(row: Row[Any]) -> Says:
    if not (row.held == row.last_number == row.newest):
        yield f"has {row.held} versions and counts {row.last_number}"


def _version(row: Row[Any]) -> Says:
    if len(row.content) != row.size_bytes or hashlib.sha256(row.content).hexdigest() != row.checksum:
        yield "its content differs from its checksum"


def _of_each(row: Table, says: ColumnElement[Any], which: ColumnElement[bool]) -> ScalarSelect[Any]:
    """What the rows of another table come to that belong to a row."""
    return select(says).where(which).correlate(row).scalar_subquery()


_judged = _of_each(windows, func.count(findings.c.id), findings.c.window_id == windows.c.id)
_windows_held = _of_each(assets, func.count(windows.c.id), windows.c.asset_id == assets.c.id)
_newest_finding = _of_each(assets, func.max(findings.c.id), findings.c.asset_id == assets.c.id)
_newest_entry = _of_each(alarms, func.max(alarm_journal.c.id), alarm_journal.c.alarm_id == alarms.c.id)
_versions_held = _of_each(models, func.count(model_versions.c.number), model_versions.c.model_id == models.c.id)
_newest_version = _of_each(models, func.coalesce(func.max(model_versions.c.number), 0), model_versions.c.model_id == models.c.id)
_MORE: Mapping[Table, tuple[Select[Any], Callable[[Row[Any]], Says]]] = {
    windows: (select(windows, _judged.label("judged")), _window),
    findings: (
        select(findings, windows.c.asset_id.label("of")).join_from(findings, windows, windows.c.id == findings.c.window_id),
        _finding,
    ),
    assets: (select(assets, _newest_finding.label("newest"), _windows_held.label("held")), _asset),
    alarms: (
        select(alarms, alarm_journal.c.state.label("written")).join_from(
            alarms, alarm_journal, alarm_journal.c.id == _newest_entry, isouter=True
        ),
        _alarm,
    ),
    models: (select(models, _newest_version.label("newest"), _versions_held.label("held")), _model),
    model_versions: (select(model_versions), _version),
}
"""What is asked of a row of some tables beside its checksum, and the query that answers it."""
