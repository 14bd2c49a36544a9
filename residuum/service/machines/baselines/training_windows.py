"""The windows that a machine's baseline is trained from: those recorded before there was one, later those judged healthy."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from residuum.identification.record import Record
from residuum.service.machines.adding.channel_names import named
from residuum.service.machines.baselines.healthy_windows import healthy_windows
from residuum.service.machines.windows.complete_windows import REMEDY, holed
from residuum.service.machines.windows.kept_windows import kept_windows
from residuum.service.store import Conflict, Store

FEWEST_NEW_WINDOWS = 5
MOST = 60
"""Recorded windows that are learned from at most: the newest."""


def training_windows(
    store: Store,
    asset: str,
    leave_out: Collection[int],
    *,
    judged: bool,
    channels: Mapping[str, str],
    used: Collection[str],
) -> tuple[list[Record], int]:
    """The windows, oldest first, and how many were passed over for a hole; Conflict when there are too few.

    Parameters
    ----------
    leave_out : collection of int
        Recorded windows that somebody saw the machine not healthy in.
    judged : bool
        Whether to take windows that the present baseline judged healthy, instead of recorded ones.
    channels : mapping of the model's names to the bus's
    used : collection of str
        Signals that must be complete, by the model's names.
    """
    if judged:
        return healthy_windows(store, asset), 0
    found, holes = [], 0
    chosen = (window for window in store.recorded_windows(asset, MOST) if window not in leave_out)
    for _, record in kept_windows(store, asset, chosen):
        if holed(named(record, channels), used):
            holes += 1
        else:
            found.append(record)
    if len(found) < FEWEST_NEW_WINDOWS:
        lacking = f"; {holes} more have holes, {REMEDY}" if holes else ""
        needed = f"at least {FEWEST_NEW_WINDOWS} are needed, 20 are good"
        raise Conflict(f"asset {asset!r}: {len(found)} windows are recorded; {needed}{lacking}")
    return found, holes
