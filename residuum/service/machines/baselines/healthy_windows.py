"""The healthy life of a machine, from its stored windows: what a diagnoser may learn its limits from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from residuum.identification.record import Record
from residuum.service.machines.windows.kept_windows import kept_windows
from residuum.service.store import Conflict, Store

FEWEST_HEALTHY_WINDOWS = 8
_MOST = 120
_CHECKED_SHARE = 0.3


def healthy_windows(store: Store, asset: str) -> list[Record]:
    """The newest windows judged healthy whose signals are kept and alike (channels, units, rate), oldest first.

    Conflict when there are fewer than 8.
    """
    found: list[Record] = []
    judged = store.findings(asset, limit=_MOST, verdict="healthy").items
    for _, record in kept_windows(store, asset, (finding.window for finding in judged)):
        if not found or _alike(found[0], record):
            found.append(record)
    if len(found) < FEWEST_HEALTHY_WINDOWS:
        raise Conflict(
            f"asset {asset!r}: {len(found)} healthy windows with their signals; at least {FEWEST_HEALTHY_WINDOWS} are needed"
        )
    return found[::-1]


def parted(windows: Sequence[Record]) -> tuple[list[Record], list[Record]]:
    """Earlier windows to learn from, overlapping ones joined, and the last 30 % to check with, none of which was learned from."""
    count = len(windows) - max(2, round(_CHECKED_SHARE * len(windows)))
    learned, last = joined(windows[:count]), windows[count - 1]
    apart = [record for record in windows[count:] if not _overlap(last, record)]
    return learned, apart or list(windows[count:])


def joined(windows: Sequence[Record]) -> list[Record]:
    """Windows of one recorder that overlap, sample for sample, as the one record they were cut from."""
    records: list[Record] = []
    for window in windows:
        last = records[-1] if records else None
        shared = 0 if last is None else _overlap(last, window)
        if last is None or not _same(last, window, shared):
            records.append(window)
            continue
        channels = {name: np.concatenate([last[name], window[name][shared:]]) for name in last.channels}
        records[-1] = replace(last, channels=channels)
    return records


def _overlap(last: Record, window: Record) -> int:
    """Samples at the end of `last` that the next window begins with, by the recorder's clock; 0 when it does not go on."""
    begin = round((window.t0 - last.t0) / last.sample_time)
    return last.n - begin if 0 <= begin < last.n < begin + window.n else 0


def _same(last: Record, window: Record, shared: int) -> bool:
    """Whether the shared samples are equal: a clock that began anew could make strangers look like neighbours."""
    return shared > 0 and all(np.array_equal(last[c][-shared:], window[c][:shared], equal_nan=True) for c in last.channels)


def _alike(one: Record, other: Record) -> bool:
    return one.units == other.units and abs(one.sample_time / other.sample_time - 1) < 1e-6
