"""The names of signals: those on the bus, and those that a diagnoser or its model uses."""

from __future__ import annotations

from collections.abc import Mapping

from residuum.identification.record import Record


def named(record: Record, channels: Mapping[str, str]) -> Record:
    """The record with the names that the diagnoser uses, where `channels` gives them (diagnoser's name → bus's name).

    A channel of the bus that is called as another one is to be called gives way to it. A record that has the
    diagnoser's names already stays as it is.
    """
    renamed = {bus: name for name, bus in channels.items() if bus in record.names and bus != name}
    taken = set(renamed.values())
    kept = record.select([name for name in record.names if name in renamed or name not in taken])
    return kept.rename(renamed) if renamed else record
