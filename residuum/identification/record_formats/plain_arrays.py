"""A record as plain arrays in a folder, beside a description in JSON: how one process hands it to
another.
"""

import json
from pathlib import Path

import numpy as np

from residuum.identification.record import Record

_DESCRIPTION = "record.json"


def keep_plain(record: Record, folder: Path) -> None:
    """Write a record's channels, one `.npy` file each, and its description into a folder that is
    there.
    """
    for number, name in enumerate(record.names):
        np.save(folder / f"{number}.npy", record[name], allow_pickle=False)
    units = {name: record.units[name] for name in record.names}
    described = {
        "units": units,
        "sample_time": record.sample_time,
        "t0": record.t0,
        "notes": list(record.notes),
    }
    (folder / _DESCRIPTION).write_text(json.dumps(described), encoding="utf-8")


def load_plain(folder: Path, source: str) -> Record:
    """The record that `keep_plain` wrote there; nothing is unpickled."""
    described = json.loads((folder / _DESCRIPTION).read_text(encoding="utf-8"))
    names = list(described["units"])
    channels = {
        name: np.load(folder / f"{number}.npy", allow_pickle=False)
        for number, name in enumerate(names)
    }
    units, notes = described["units"], tuple(described["notes"])
    return Record(
        channels, units, described["sample_time"], described["t0"], notes=notes, source=source
    )
