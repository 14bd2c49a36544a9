"""The alarms of all machines with what their rules say of them, as a table (ANSI/ISA-18.2, clause
9: rationalisation).
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Collection, Iterator
from typing import Any

from residuum.service.alarms.alarm_states import MACHINE, SIGNAL, AlarmRule
from residuum.service.storage.disk_store import DiskStore
from residuum.service.store import Asset

# In the table's order; a plant without machines has them, too.
_COLUMNS = (
    "machine",
    "title",
    "alarm",
    "diagnoser",
    "limits",
    "deadband",
    "on_delay",
    "off_delay",
    "latch",
    "consequence",
    "time_to_respond",
    "priority",
    "action",
    "suppressed_while",
    "shelving_reason",
    "longest_shelving_minutes",
)
_MACHINES_AT_ONCE = 100
# What a spreadsheet takes for the begin of a formula.
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def rationalisation_table(
    store: DiskStore,
    rule_of: Callable[[str], AlarmRule],
    sites: Collection[str] | None = None,
) -> str:
    """CSV with a row a machine and kind of alarm, times in seconds, limits as the latest finding
    was judged by.

    A text that a spreadsheet would take for a formula begins with an apostrophe.
    """
    rows = [
        _row(asset, kind, rule_of(asset.id))
        for asset in _all_assets(store, sites)
        for kind in (MACHINE, SIGNAL)
    ]
    # CRLF, as RFC 4180 has it and spreadsheets write it
    text = io.StringIO()
    table = csv.DictWriter(text, _COLUMNS, lineterminator="\r\n")
    table.writeheader()
    table.writerows(rows)
    return text.getvalue()


def _all_assets(store: DiskStore, sites: Collection[str] | None) -> Iterator[Asset]:
    cursor = None
    while True:
        page = store.assets(cursor, _MACHINES_AT_ONCE, sites)
        yield from page.items
        cursor = page.next_cursor
        if cursor is None:
            return


def _row(asset: Asset, kind: str, rule: AlarmRule) -> dict[str, Any]:
    priority = rule.priority(kind)
    row = {
        "machine": asset.id,
        "title": asset.title,
        "alarm": kind,
        "diagnoser": asset.diagnoser or "",
        "limits": _limits(asset) if kind == MACHINE else "windows that cannot be judged",
        # windows that cannot be judged have no limit to lie below
        "deadband": rule.deadband if kind == MACHINE else "",
        "on_delay": rule.on_delay,
        "off_delay": rule.off_delay,
        "latch": rule.latch,
        "consequence": rule.consequence or "",
        "time_to_respond": "" if rule.time_to_respond is None else rule.time_to_respond,
        "priority": "" if priority is None else priority.value,
        "action": rule.action,
        "suppressed_while": "; ".join(map(str, rule.suppress)),
        "shelving_reason": rule.shelving_reason,
        "longest_shelving_minutes": rule.longest_shelving,
    }
    return {name: _no_formula(value) for name, value in row.items()}


def _limits(asset: Asset) -> str:
    if asset.last_finding is None:
        return ""
    finding = asset.last_finding.finding
    limits = [
        f"{name} {limit:g} {finding.units.get(name, '')}".rstrip()
        for name, limit in finding.thresholds.items()
        if limit is not None
    ]
    return "; ".join(limits)


def _no_formula(value: Any) -> Any:
    return f"'{value}" if isinstance(value, str) and value.startswith(_FORMULA) else value
