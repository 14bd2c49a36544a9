"""How blocks are cut: of whole runs where a model follows the records, else of stretches on its filter's track.

*Whole runs.* Where the model, its parameters estimated, follows the records better than their mean would, it is simulated through
them from one initial state, and the blocks are parts of that run: long enough for what acts slowly.

*Stretches.* Where it does not (a plant that integrates, a closed loop), stretches begin at the states that a filter's smoother
finds, so that nothing but the model's own terms can explain what happens in them: free first states would imitate whatever is
missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.held_out_blocks import Blocks, Fold, Spans, errors_on, estimated, fitted
from residuum.identification.discrepancy.policy.blocks import (
    ESTIMATED,
    FEWEST_BLOCKS,
    FIRST_LOOK_SAMPLES,
    FIRST_SAMPLES,
    FOLLOWS,
    LONGEST_STRETCH,
    MOST_BLOCKS,
    MOST_STRETCH_SAMPLES,
    PIECES,
    SHORTEST_PIECE,
    SHORTEST_STRETCH,
    SHOWN,
    STRETCHES,
    THINNED_FROM,
)
from residuum.identification.discrepancy.track import Track, joined
from residuum.identification.physics import Estimate, Experiment, PhysicalModel, Simulator, windows
from residuum.identification.physics.simulate.kalman import Filter, first_noise, noise_floor

FloatArray = npt.NDArray[np.float64]


def blocks_of(model: PhysicalModel, experiments: Sequence[Experiment]) -> Blocks | None:
    """Blocks of the experiments: of whole runs where the model follows them, else stretches that begin on its filter's track.

    None where the filter diverges or the records are too short.
    """
    run = _whole_run(model, experiments)
    along = _followed(model if run is None else run.model, experiments)
    if along is None:
        return None
    states, track = along
    noise = np.nan_to_num(noise_floor(track.experiment.Y))
    folds = None if run is None else _parts_of(experiments)
    if run is None or folds is None:
        return _stretches_of(model, experiments, states, track, noise)
    looked = Fold(list(experiments), [], [], 0)
    base = fitted(run.model, looked, initial=run.initial)
    return None if base is None else Blocks(base, looked, folds, track, _simulated(run, experiments), noise)


def _simulated(run: Estimate, experiments: Sequence[Experiment]) -> list[FloatArray]:
    simulator = Simulator(run.model)
    runs = simulator.run_each(experiments, run.initial, simulator.p(), substeps=run.substeps)
    return [each.X for each in runs]


def _followed(model: PhysicalModel, experiments: Sequence[Experiment]) -> tuple[list[FloatArray], Track] | None:
    """The filter's smoothed states in each experiment, and what the balances lacked along them."""
    kalman, simulator = Filter(model, first_noise(model, list(experiments))), Simulator(model)
    found = [kalman.run(e, simulator.x0(e.known)) for e in experiments]
    if not all(np.all(np.isfinite(s.X)) for s in found):
        return None
    states = [s.X for s in found]
    lacks = [{b: s.missing[b].value if b in s.missing else np.zeros(len(s.X)) for b in model.balances} for s in found]
    return states, joined(experiments, states, lacks)


def _whole_run(model: PhysicalModel, experiments: Sequence[Experiment]) -> Estimate | None:
    """The model at its least simulation error over whole runs, where that is less than the outputs move; else None."""
    found = estimated(model, experiments, ESTIMATED)
    if found is None:
        return None
    errors, Y = np.concatenate(found.residuals), np.concatenate([e.Y for e in experiments])
    seen = np.isfinite(Y).any(axis=0)
    with np.errstate(invalid="ignore"):
        left = np.sqrt(np.nanmean(errors[:, seen] ** 2, axis=0)) / np.nanstd(Y[:, seen], axis=0)
    return found if np.all(left < FOLLOWS) else None


def _parts_of(experiments: Sequence[Experiment]) -> tuple[Fold, Fold] | None:
    """Two folds of whole runs; None where the records are too short for blocks."""
    total = sum(e.n for e in experiments)
    count = min(MOST_BLOCKS, total // (PIECES * SHORTEST_PIECE))
    if count < FEWEST_BLOCKS:
        return None
    spans: list[Spans] = []
    for e in experiments:
        spans.append(_pieces(e.n, total / (count * PIECES), sum(map(len, spans))))
    blocks = -(-sum(map(len, spans)) // PIECES)
    return _fold(experiments, spans, 0, blocks), _fold(experiments, spans, 1, blocks)


def _pieces(n: int, length: float, before: int) -> Spans:
    """Pieces of about this length, after the beginning, where so many came `before`."""
    first = min(FIRST_SAMPLES, n // 2)
    edges = np.linspace(first, n, max(1, round((n - first) / length)) + 1).round().astype(int).tolist()
    return [(a, b, (before + k) // PIECES) for k, (a, b) in enumerate(pairwise(edges))]


def _fold(experiments: Sequence[Experiment], spans: list[Spans], turn: int, blocks: int) -> Fold:
    """Every second piece judges, from the one whose `turn` it is."""
    train, test, kept = [], [], []
    begun = 0
    for e, pieces in zip(experiments, spans, strict=True):
        judges = [piece for k, piece in enumerate(pieces, begun) if k % 2 == turn]
        begun += len(pieces)
        aside = np.zeros(e.n, dtype=bool)
        for begin, end, _ in judges:
            aside[begin:end] = True
        train.append(replace(e, Y=np.where(aside[:, None], np.nan, e.Y), block=1))
        test.append(replace(e, Y=np.where(aside[:, None], e.Y, np.nan), block=1))
        kept.append(judges)
    return Fold(train, test, kept, blocks)


def _stretches_of(
    model: PhysicalModel, experiments: Sequence[Experiment], states: Sequence[FloatArray], track: Track, noise: FloatArray
) -> Blocks | None:
    """Stretches as short as show the model's error: at least `SHOWN` times the noise of an output."""
    total, blocks = sum(e.n for e in experiments), None
    for count in STRETCHES:
        samples = int(np.clip(total // count, SHORTEST_STRETCH, LONGEST_STRETCH))
        parts = _stretches(Simulator(model).states, experiments, states, samples)
        if len(parts) < FEWEST_BLOCKS:
            break
        parts = _thinned(parts, max(1, total // MOST_STRETCH_SAMPLES))
        folds = _of_stretches(parts, 0), _of_stretches(parts, 1)
        every = max(1, round(sum(part.n for part in folds[0].train) / FIRST_LOOK_SAMPLES))
        looked = replace(folds[0], train=folds[0].train[::every])
        base, trained = fitted(model, looked), fitted(model, folds[0])
        if base is None:
            break
        blocks = Blocks(base, looked, folds, track, list(states), noise)
        errors = None if trained is None else errors_on(trained, folds[0])
        if errors is None or errors.stands_out(noise, SHOWN) or samples == LONGEST_STRETCH:
            break
    return blocks


def _of_stretches(parts: list[Experiment], turn: int) -> Fold:
    """Every second stretch judges, from the one whose `turn` it is, each a block of its own."""
    judges = [(part, [(0, part.n, k)]) for k, part in enumerate(parts) if k % 2 == turn]
    return Fold(parts[1 - turn :: 2], [part for part, _ in judges], [span for _, span in judges], len(parts))


def _stretches(states: Sequence[str], experiments: Sequence[Experiment], X: Sequence[FloatArray], n: int) -> list[Experiment]:
    parts = []
    for e, along in zip(experiments, X, strict=True):
        for part in windows(e, min(n, e.n)):
            row = round((part.t0 - e.t0) / e.sample_time)
            if 2 * part.n > n:
                parts.append(replace(part, known=dict(zip(states, along[row].tolist(), strict=False)), block=1))
    return parts


def _thinned(parts: list[Experiment], every: int) -> list[Experiment]:
    """Neighbours in pairs, of which one trains and the other tests, one pair of so many."""
    return [part for k, part in enumerate(parts) if (k // 2) % every == 0] if len(parts) > THINNED_FROM else parts
