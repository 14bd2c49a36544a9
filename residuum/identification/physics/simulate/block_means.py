"""Means of consecutive blocks of samples; one that lacks a sample is missing, the last, incomplete
one is left out.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from residuum.kept_loops import njit

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]


def block_means(values: Array, block: int) -> Array:
    """Means along axis 0."""
    return means_in_blocks(values, np.array([0, len(values)]), [block])[0]


def means_in_blocks(
    values: Array, starts: Integers, blocks: Sequence[int]
) -> tuple[Array, Integers]:
    """Means along axis 0 of several pieces. Piece k is values[starts[k]] … values[starts[k + 1] −
    1], in blocks of blocks[k]. Also where those of each piece start and the last ones end.
    """
    if all(block == 1 for block in blocks):
        return values, starts
    sizes = np.array(blocks, dtype=np.int64)
    block_starts = np.concatenate([[0], np.cumsum(np.diff(starts) // sizes)])
    rows = np.ascontiguousarray(values).reshape(len(values), -1)
    means = np.zeros((block_starts[-1], rows.shape[1]))
    _add_means(rows, starts, sizes, block_starts, means)
    return means.reshape(-1, *values.shape[1:]), block_starts


@njit(error_model="numpy")
def _add_means(rows, starts, blocks, found, means):  # type: ignore[no-untyped-def]
    for k in range(blocks.shape[0]):
        for j in range(found[k + 1] - found[k]):
            for i in range(blocks[k]):
                for c in range(rows.shape[1]):
                    means[found[k] + j, c] += rows[starts[k] + j * blocks[k] + i, c]
            for c in range(rows.shape[1]):
                means[found[k] + j, c] /= blocks[k]
