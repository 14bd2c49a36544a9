"""The kind of a run, told by what was not estimated: its inputs, and the channels recorded beside
the model's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from residuum.array_types import FloatArray
from residuum.diagnosis.model_based.policy import STILL
from residuum.identification.physics import Experiment


@dataclass(frozen=True, eq=False)
class KindOfRun:
    """Features of a window: of every input its mean, its standard deviation and the RMS of its
    steps, of other channels the mean.

    Attributes
    ----------
    beside : tuple of str
        Channels that the model does not use.
    centre, spread : array, shape (features,)
        Over healthy windows; the spread is infinite for what never moved, which then says nothing.
    """

    beside: tuple[str, ...]
    centre: FloatArray
    spread: FloatArray

    @classmethod
    def of(cls, windows: Sequence[Experiment]) -> KindOfRun:
        """Of healthy windows."""
        beside = tuple(name for name in windows[0].spare if all(name in e.spare for e in windows))
        F = np.array([_raw(e, beside) for e in windows])
        # what hardly moves from run to run would else be divided by its noise
        spread = np.maximum(F.std(axis=0), STILL * np.max(np.abs(F), axis=0, initial=0.0))
        return cls(beside, F.mean(axis=0), np.where(spread > 0.0, spread, np.inf))

    def features(self, e: Experiment) -> FloatArray:
        """1 and the features in healthy spreads, shape (1 + features,); usual (0) for a channel
        that was not recorded.
        """
        return np.concatenate(
            [[1.0], np.nan_to_num((_raw(e, self.beside) - self.centre) / self.spread)]
        )


def _raw(e: Experiment, beside: Sequence[str]) -> FloatArray:
    means = [float(e.spare[name].values.mean()) if name in e.spare else np.nan for name in beside]
    return np.concatenate(
        [
            e.U.mean(axis=0),
            e.U.std(axis=0),
            np.sqrt(np.mean(np.diff(e.U, axis=0) ** 2, axis=0)),
            means,
        ]
    )
