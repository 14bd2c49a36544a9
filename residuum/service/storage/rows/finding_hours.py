"""What is kept of findings whose rows are let go: a row an hour and asset, with counts, extremes
and means of every indicator.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping
from datetime import datetime
from typing import Any

from sqlalchemy import Connection, Row, delete, insert, select

from residuum.diagnosis.finding import Verdict
from residuum.service.storage.rows import assets, row_checks
from residuum.service.storage.tables import finding_hours, findings
from residuum.service.store import FindingHour


def add(connection: Connection, forgotten: Iterable[Row[Any]]) -> None:
    """Fold findings whose rows go into their hours; what an hour holds already is counted with
    them.
    """
    by_hour: dict[tuple[str, datetime], list[Row[Any]]] = defaultdict(list)
    for row in forgotten:
        by_hour[row.asset_id, row.at.replace(minute=0, second=0, microsecond=0)].append(row)
    for (asset, hour), rows in by_hour.items():
        of_hour = (finding_hours.c.asset_id == asset) & (finding_hours.c.hour == hour)
        known = connection.execute(select(finding_hours).where(of_hour)).first()
        values = {"asset_id": asset, "hour": hour, **_summary(known, rows)}
        if known is None or not row_checks.differs(finding_hours, known._mapping):
            values = row_checks.sealed(finding_hours, values)
        else:
            # The old checksum differs from the new values too: an hour that was damaged must not
            # become whole by what is added to it.
            values["checksum"] = known.checksum
        connection.execute(delete(finding_hours).where(of_hour))
        connection.execute(insert(finding_hours).values(values))


def _summary(known: Row[Any] | None, rows: Collection[Row[Any]]) -> dict[str, Any]:
    """The findings of an hour with what is known of it."""
    verdicts: dict[str, int] = dict(known.verdicts) if known else {}
    indicators: dict[str, Any] = dict(known.indicators) if known else {}
    for row in rows:
        if row_checks.differs(findings, row._mapping):
            # Of a damaged row it is certain only that there was a window.
            unknown = Verdict.NOT_ASSESSABLE.value
            verdicts[unknown] = verdicts.get(unknown, 0) + 1
            continue
        verdicts[row.verdict] = verdicts.get(row.verdict, 0) + 1
        for name, value in row.indicators.items():
            if value is not None and math.isfinite(value):
                unit, threshold = row.units.get(name, ""), row.thresholds.get(name)
                indicators[name] = _folded(indicators.get(name), value, unit, threshold)
    count = (known.windows if known else 0) + len(rows)
    return {"windows": count, "verdicts": verdicts, "indicators": indicators}


def newest(connection: Connection, asset: str, limit: int = 24 * 30) -> list[FindingHour]:
    """The newest hours of an asset, oldest first."""
    assets.require(connection, asset)
    query = (
        select(finding_hours)
        .where(finding_hours.c.asset_id == asset)
        .order_by(finding_hours.c.hour.desc())
        .limit(limit)
    )
    return [_hour(row) for row in connection.execute(query)][::-1]


def _hour(row: Row[Any]) -> FindingHour:
    if row_checks.differs(finding_hours, row._mapping):
        raise row_checks.refuse(f"hour {row.hour:%Y-%m-%d %H} of {row.asset_id!r}")
    return FindingHour(row.hour, row.windows, row.verdicts, row.indicators)


def _folded(
    known: Mapping[str, Any] | None, value: float, unit: str, threshold: float | None
) -> dict[str, Any]:
    if known is None:
        return {
            "unit": unit,
            "n": 1,
            "minimum": value,
            "maximum": value,
            "mean": value,
            "threshold": threshold,
        }
    n = known["n"] + 1
    return {
        "unit": unit,
        "n": n,
        "minimum": min(known["minimum"], value),
        "maximum": max(known["maximum"], value),
        # x̄_n = x̄_{n−1} + (x_n − x̄_{n−1}) / n: the values before are gone
        "mean": known["mean"] + (value - known["mean"]) / n,
        "threshold": threshold,
    }
