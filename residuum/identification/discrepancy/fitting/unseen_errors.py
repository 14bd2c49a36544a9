"""Errors of a fitted structure on blocks that it has not seen, by deletion from its own equations: nothing is simulated again.

The structure is at the top of its likelihood. Without a fold of blocks its values move by

    δθ = (Σ H_rest + d·diag Σ H)⁻¹ Σ g_rest,

with the whitened slopes' H and g of each fold, first states projected out (`unseen_blocks.judged`), and its errors by −J δθ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.fitting.structures import Structure, innovation_scales
from residuum.identification.physics import Experiment
from residuum.identification.physics.estimation.least_squares import solve_scaled
from residuum.identification.unseen_blocks.comparing import share
from residuum.identification.unseen_blocks.data import folds_of
from residuum.identification.unseen_blocks.judged import moved
from residuum.identification.unseen_blocks.policy import FOLDS, WINDOW_SAMPLES
from residuum.identification.unseen_blocks.remaining import Remaining

FloatArray = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Blocks:
    """Blocks of experiments: the block of each row (rows,), and of each block its fold and measured samples (blocks, outputs).
    The record of each block, with its begin and end [s] in that record's time, too.
    """

    row: Integers
    fold: Integers
    count: FloatArray
    record: list[int]
    times: list[tuple[float, float]]


def blocks_of(experiments: Sequence[Experiment]) -> Blocks | None:
    """The blocks; None where the records are too short for any."""
    lengths = [len(e.means(e.Y)) for e in experiments]
    windows, samples = len(lengths), sum(lengths)
    each, fold = folds_of(windows, min(lengths))
    fewest = FOLDS * WINDOW_SAMPLES
    if samples < fewest * windows:  # windows so short are blocks themselves
        if windows < FOLDS or samples < fewest:
            return None
        each, fold = 1, np.arange(windows) % FOLDS
    row = np.concatenate([np.arange(n) * each // n + k * each for k, n in enumerate(lengths)])
    known = np.isfinite(np.concatenate([e.means(e.Y) for e in experiments])).astype(float)
    count = np.column_stack([np.bincount(row, weights=c, minlength=len(fold)) for c in known.T])
    edges = np.arange(each + 1) / each
    times = [e.t0 + e.sample_time * np.ceil(e.n * edges) for e in experiments]
    begins = np.cumsum([0, *(not after.follows(before) for before, after in pairwise(experiments))])
    return Blocks(
        row,
        fold,
        np.asarray(count, dtype=float),
        np.repeat(begins, each).tolist(),
        [(float(t[k]), float(t[k + 1])) for t in times for k in range(each)],
    )


def unseen(structure: Structure, blocks: Blocks) -> FloatArray:
    """Sums of squared errors on unseen blocks, shape (blocks, outputs), in the outputs' units."""
    raw = np.concatenate(structure.residuals)
    known = np.isfinite(raw)
    white, slopes, plain = [], [], []
    for r, J, X in zip(structure.residuals, structure.by_parameters, structure.by_states, strict=True):
        w, S = _whitened(structure, np.concatenate([r[..., None], J, X], axis=2))
        q = J.shape[2]
        x, t = S[..., q:].reshape(r.size, X.shape[2]), S[..., :q].reshape(r.size, q)
        beside = solve_scaled(x.T @ x, x.T @ t, 1e-12)
        white.append(w)
        slopes.append(S[..., :q] - S[..., q:] @ beside)
        plain.append(J - X @ beside)
    T, e = np.concatenate(slopes), np.concatenate(white)
    left = np.where(known, raw, 0.0)
    if T.shape[2]:
        in_fold = blocks.fold[blocks.row]
        J = np.concatenate(plain)
        for k, step in moved(T, e, in_fold).items():
            rows = in_fold == k
            left[rows] -= np.where(known[rows], J[rows] @ step, 0.0)
    return np.column_stack([np.bincount(blocks.row, weights=c, minlength=len(blocks.fold)) for c in (left**2).T])


def _whitened(structure: Structure, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Residuals (n, outputs) and slopes (n, outputs, m) in units of the innovations; 0 where nothing is known."""
    out = np.zeros_like(values)
    for o, noise in enumerate(structure.noises):
        if noise is not None:
            out[:, o] = np.nan_to_num(noise.innovations(values[:, o]) / np.sqrt(noise.innovation_variance))
    return out[..., 0], out[..., 1:]


def remaining_of(before: FloatArray, after: FloatArray, best: Structure, blocks: Blocks) -> Remaining:
    """What `best` leaves on unseen blocks; `before` and `after` are sums of squares (blocks, outputs) of the base and of it."""
    noise = innovation_scales(best.noises)
    seen = (blocks.count.sum(axis=0) > 0.0) & (noise > 0.0)
    times = np.sqrt(after[:, seen].sum(axis=0) / blocks.count[:, seen].sum(axis=0)) / noise[seen]
    largest = float(times.max()) if times.size else float("inf")
    total = before.sum(axis=0)
    where = int(np.argmax((after[:, total > 0.0] / total[total > 0.0]).sum(axis=1)))
    return Remaining(1.0 - share(before, after)[0], largest, blocks.times[where])
