"""Windows that a model can be held against: those without a hole in a signal that the model uses."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from residuum.identification.record import Record
from residuum.service.machines.adding.channel_guess import model_signals
from residuum.service.machines.adding.channel_names import named
from residuum.service.machines.adding.model_texts import ModelText
from residuum.service.machines.windows.kept_windows import kept_windows
from residuum.service.store import Conflict, Store
from residuum.service.views.model_view import model_of


def complete_windows(
    store: Store, asset: str, windows: Sequence[int], channels: Mapping[str, str], used: Collection[str], most: int
) -> dict[int, Record]:
    """The newest of these windows without a hole, at most so many, oldest first; Conflict when each has one.

    A machine whose registers are polled loses a sample now and then; one such window must not stop a comparison.

    Parameters
    ----------
    channels : mapping of the model's names to the bus's
    used : collection of str
        Signals that the model uses, by its names.
    """
    found: dict[int, Record] = {}
    for window, kept in kept_windows(store, asset, sorted(set(windows), reverse=True)):
        record = named(kept, channels)
        if not holed(record, used):
            found[window] = record
        if len(found) == most:
            break
    if not found:
        raise Conflict(f"asset {asset!r}: none of {len(windows)} windows is complete; {REMEDY}")
    return dict(sorted(found.items()))


REMEDY = "samples of a signal that the model uses are missing: read less often (seconds between two reads), or record longer"


def holed(record: Record, used: Collection[str]) -> bool:
    """Whether a signal in use lacks a sample."""
    return any(record.missing(name).any() for name in record.names if name in used)


def used_by(model: ModelText | None) -> Collection[str]:
    """The signals that a model uses, by its names; none without a model."""
    return () if model is None else model_signals(model_of(*model))
