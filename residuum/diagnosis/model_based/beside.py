"""What a window was recorded under: means of the channels that the model does not use, and of its inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from residuum.identification.physics import PhysicalModel
from residuum.identification.record import Record

Array = npt.NDArray[np.float64]

_STILL = 1e-9
"""Share of its size by which a condition must differ between healthy windows to be one."""


@dataclass(frozen=True, eq=False)
class Beside:
    """Channels whose mean over a window (its `size`: the root of its mean square) healthy values may move with.

    Attributes
    ----------
    of_what : tuple of (channel, "mean" or "size")
    centre, spread : array, shape (c,)
        Mean and standard deviation of each over healthy windows.
    """

    of_what: tuple[tuple[str, str], ...]
    centre: Array
    spread: Array

    @classmethod
    def of(cls, model: PhysicalModel, records: Sequence[Record]) -> Beside:
        """Of healthy windows: every channel that all of them have and that is no output of the model."""
        shared = [n for n in records[0].names if n not in model.outputs and all(n in r.names for r in records)]
        named = [(n, "mean") for n in shared] + [(n, "size") for n in shared if n in model.inputs]
        X = np.array([[_value(r, *each) for each in named] for r in records]).reshape(len(records), len(named))
        with np.errstate(invalid="ignore"):
            spread = X.std(axis=0, ddof=1)
            moves = np.isfinite(spread) & (spread > _STILL * np.max(np.abs(X), axis=0, initial=0.0))
        kept = tuple(each for each, there in zip(named, moves, strict=True) if there)
        return cls(kept, X.mean(axis=0)[moves], spread[moves])

    def conditions(self, record: Record) -> Array:
        """In standard deviations of the healthy windows; zero (what is usual) for a channel that was not recorded."""
        values = [_value(record, *each) if each[0] in record.names else np.nan for each in self.of_what]
        return np.nan_to_num((np.array(values).reshape(len(self.of_what)) - self.centre) / self.spread)

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {"of_what": [list(each) for each in self.of_what], "centre": self.centre.tolist(), "spread": self.spread.tolist()}

    @classmethod
    def from_json(cls, stored: Mapping[str, Any]) -> Beside:
        """What `to_json` gave."""
        of_what = tuple((str(name), str(what)) for name, what in stored["of_what"])
        return cls(of_what, np.array(stored["centre"], dtype=float), np.array(stored["spread"], dtype=float))


def _value(record: Record, name: str, what: str) -> float:
    y = record[name]
    there = y[np.isfinite(y)]
    if not there.size:
        return np.nan
    return float(np.mean(there)) if what == "mean" else float(np.sqrt(np.mean(there**2)))
