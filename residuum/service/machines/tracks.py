"""A machine's parameters and effects over its windows, from the findings that are kept; the work of
a job.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import orjson

from residuum.diagnosis.tracks import FEWEST_WINDOWS_OF_A_TRACK, Track, track
from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.identification.units import compatible
from residuum.library.questions.compare import Compare
from residuum.service.machines.adding import KIND, ModelText, document_name, kept_document, named
from residuum.service.storage.disk_store import DiskStore
from residuum.service.views.model_view import view_model
from residuum.service.work.jobs import Progress
from residuum.service.work.worker_pool import RecordParts, parts_of

# Limits that a user sets on a machine's parameters and effects: what must not be passed.


def _name(asset: str) -> str:
    return f"{asset}.limits"


def limits_of(store: DiskStore, asset: str) -> dict[str, float]:
    """Name of a parameter → its limit, in the parameter's unit; none for a machine whose name is
    too long for a document.
    """
    return {
        str(name): float(value)
        for name, value in (kept_document(store, _name(asset)) or {}).items()
    }


def keep_limits(store: DiskStore, asset: str, limits: Mapping[str, float], by: str) -> None:
    """Keep the limits in the place of those before; Conflict for a machine whose name is too long
    for a document.
    """
    document_name(asset)  # refuses a name that is too long
    store.add_model_version(_name(asset), KIND, orjson.dumps(dict(limits)), "limits", by)


# Windows that tell parameters, the newest, that a track is made of.
_MOST = 1000
_PAGE = 500
# Seconds by which two windows must differ in time.
_SHORTEST = 1e-3


def told_parameters(store: DiskStore, asset: str) -> list[dict[str, Any]]:
    """What the newest windows told of every parameter, oldest first: `at` [s since 1970],
    `parameters`, `conditions`.
    """
    rows: list[dict[str, Any]] = []
    cursor = None
    while len(rows) < _MOST:
        page = store.findings(asset, cursor, _PAGE)
        for stored in page.items:
            evidence = stored.finding.evidence
            if evidence.get("parameters"):
                header = {
                    "at": stored.at.timestamp(),
                    "window": stored.window,
                    "verdict": stored.finding.verdict.value,
                }
                rows.append(
                    {
                        **header,
                        "parameters": evidence["parameters"],
                        "conditions": evidence.get("conditions", {}),
                    }
                )
        cursor = page.next_cursor
        if cursor is None:
            break
    return rows[::-1]


def follow(
    progress: Progress,
    rows: Sequence[Mapping[str, Any]],
    limits: Mapping[str, float],
    moves_with: Sequence[str] | None,
) -> Mapping[str, Any]:
    """Follow every parameter over the windows.

    Parameters
    ----------
    rows : sequence
        See `told_parameters`.
    limits : mapping
        Of some parameters.
    moves_with : sequence of str or None
        Signals whose means the parameters may move with; None: every temperature that was recorded.

    Returns
    -------
    mapping
        `items`: by parameter its `unit`, `healthy` band, the windows' `time`, `window`, `verdict`,
        `value` and `std`, the `limit`, and `track`, or None with the `reason`.
    """
    names = sorted({name for row in rows for name in row["parameters"]})
    items = []
    for number, name in enumerate(names):
        progress(number / max(len(names), 1), name)
        items.append(_followed(name, rows, limits.get(name), moves_with))
    return {"items": items}


def _followed(
    name: str,
    all_rows: Sequence[Mapping[str, Any]],
    limit: float | None,
    moves_with: Sequence[str] | None,
) -> dict[str, Any]:
    """One parameter over the windows that tell it, with its track or why it has none."""
    rows = [row for row in all_rows if row["parameters"].get(name, {}).get("value") is not None]
    item = _item(name, rows, limit)
    chosen = _moves_with(rows, moves_with)
    try:
        trend = _trend(item, rows, chosen)
    except BadInput as error:
        return {**item, "moves_with": chosen, "track": None, "reason": str(error)}
    return {**item, "moves_with": chosen, "track": trend.to_json(), "reason": None}


def _item(name: str, rows: Sequence[Mapping[str, Any]], limit: float | None) -> dict[str, Any]:
    """A parameter's values by window, as they are answered."""
    estimates = [row["parameters"][name] for row in rows]
    # unit and healthy band as the newest window has them: a baseline may have been trained anew
    newest = estimates[-1]
    return {
        "parameter": name,
        "unit": newest["unit"],
        "healthy": newest.get("healthy") or None,
        "limit": limit,
        "time": [row["at"] for row in rows],
        "window": [row["window"] for row in rows],
        "verdict": [row["verdict"] for row in rows],
        "value": [parameter["value"] for parameter in estimates],
        "std": [parameter.get("std") or 0.0 for parameter in estimates],
    }


def _trend(
    item: Mapping[str, Any], rows: Sequence[Mapping[str, Any]], moves_with: Sequence[str]
) -> Track:
    """The track of an item's values; BadInput where they are too few or none can be made of them."""
    if len(rows) < FEWEST_WINDOWS_OF_A_TRACK:
        raise BadInput(
            f"{len(rows)} windows tell it; at least {FEWEST_WINDOWS_OF_A_TRACK} are needed"
        )
    means = [
        [row["conditions"].get(signal, {}).get("mean", np.nan) for signal in moves_with]
        for row in rows
    ]
    # a clock that was set back would let time run backwards: windows stand in their own order
    t = np.maximum.accumulate(np.array(item["time"])) + _SHORTEST * np.arange(len(rows))
    band = item["healthy"]
    return track(
        t,
        item["value"],
        item["std"],
        moves_with=np.array(means).reshape(len(rows), -1) if moves_with else None,
        healthy=(band["low"], band["high"]) if band else None,
        limit=item["limit"],
    )


def _moves_with(rows: Sequence[Mapping[str, Any]], wanted: Sequence[str] | None) -> list[str]:
    """The signals that all windows have the mean of."""
    known = [
        name for name in rows[-1]["conditions"] if all(name in row["conditions"] for row in rows)
    ]
    if wanted is not None:
        return [name for name in wanted if name in known]
    return [name for name in known if compatible(rows[-1]["conditions"][name]["unit"], "K")]


def missing_terms(
    progress: Progress,
    model: ModelText,
    window: RecordParts,
    healthy: Sequence[RecordParts],
    channels: Mapping[str, str],
) -> Mapping[str, Any]:
    """What the balances lack along every axis: in one window now, and in healthy windows.

    Returns
    -------
    mapping
        `now` and `healthy`, each the `curves` of the workbench's view.
    """
    progress(0.1, "the window of now")
    shown = [parts_of(named(Record(*parts), channels)) for parts in (window, *healthy)]
    now = view_model(_quiet, *model, shown[:1], {}, Compare())
    progress(0.5, f"{len(healthy)} healthy windows")
    before = view_model(_quiet, *model, shown[1:], {}, Compare())
    return {"now": now["curves"], "healthy": before["curves"]}


def _quiet(_share: float, _doing: str) -> None:
    """Tell nobody."""
