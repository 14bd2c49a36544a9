"""The windows that a machine's baseline is trained from: those recorded before there was one, later those judged healthy."""

from __future__ import annotations

from collections.abc import Collection

from residuum.identification.record import Record
from residuum.service.machines.healthy_windows import healthy_windows
from residuum.service.store import Conflict, SignalLetGo, Store

FEWEST_NEW_WINDOWS = 5
_MOST = 60


def training_windows(store: Store, asset: str, leave_out: Collection[int], *, judged: bool) -> list[Record]:
    """The windows, oldest first; Conflict when there are too few.

    Parameters
    ----------
    leave_out : collection of int
        Recorded windows that somebody saw the machine not healthy in.
    judged : bool
        Whether to take windows that the present baseline judged healthy, instead of recorded ones.
    """
    if judged:
        return healthy_windows(store, asset)
    found = []
    for window in store.recorded_windows(asset, _MOST):
        if window not in leave_out:
            try:
                found.append(store.window_record(asset, window))
            except SignalLetGo:
                continue
    if len(found) < FEWEST_NEW_WINDOWS:
        raise Conflict(
            f"asset {asset!r}: {len(found)} windows are recorded; at least {FEWEST_NEW_WINDOWS} are needed, 20 are good"
        )
    return found
