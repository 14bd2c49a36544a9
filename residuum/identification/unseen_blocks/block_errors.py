"""Errors block by block on unseen blocks: when in the record a model fails, and what each candidate would take away there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.physics import Key, PhysicalModel


@dataclass(frozen=True, eq=False)
class BlockErrors:
    """RMS errors on blocks that no fit has seen.

    Attributes
    ----------
    outputs, units : tuple of str
        Of the outputs that were measured.
    records : tuple of int
        The record of each block, from 0.
    times : tuple of (float, float)
        Begin and end of each block [s], in its record's time.
    before, after : array, shape (blocks, outputs)
        Of the model as it is, re-estimated, and with every effect that was accepted; NaN where nothing was measured.
    candidates : mapping of Key to array, shape (blocks, outputs)
        Of the model with one effect alone.
    """

    outputs: tuple[str, ...]
    units: tuple[str, ...]
    records: tuple[int, ...]
    times: tuple[tuple[float, float], ...]
    before: FloatArray
    after: FloatArray
    candidates: Mapping[Key, FloatArray]


def block_errors(
    model: PhysicalModel,
    records: Sequence[int],
    times: Sequence[tuple[float, float]],
    count: FloatArray,
    before: FloatArray,
    after: FloatArray,
    candidates: Mapping[Key, FloatArray],
) -> BlockErrors:
    """From sums of squares and how many samples they are of, arrays of shape (blocks, outputs); see BlockErrors."""
    seen = count.sum(axis=0) > 0.0
    outputs = [output for output, measured in zip(model.outputs.values(), seen, strict=True) if measured]

    def rms(squares: FloatArray) -> FloatArray:
        n = count[:, seen]
        return np.sqrt(np.divide(squares[:, seen], n, out=np.full(n.shape, np.nan), where=n > 0.0))

    return BlockErrors(
        outputs=tuple(output.name for output in outputs),
        units=tuple(output.unit for output in outputs),
        records=tuple(records),
        times=tuple(times),
        before=rms(before),
        after=rms(after),
        candidates={key: rms(squares) for key, squares in candidates.items()},
    )
