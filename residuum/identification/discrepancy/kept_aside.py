"""Which data a model is estimated from, which are kept aside to judge it, its error on those, and
which of several models hold there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.discrepancy.policy import (
    KEPT_RISE,
    LEAST_TO_LEARN_FROM,
    STATES_ITERATIONS,
    STATES_TOLERANCE,
)
from residuum.identification.errors import NotIdentifiable
from residuum.identification.physics import (
    Experiment,
    PhysicalModel,
    Settings,
    Simulator,
    estimate,
    match,
)
from residuum.identification.record import Record
from residuum.identification.residual_analysis.policy import STANDS_STILL, TRAINING_SHARE
from residuum.identification.unseen_blocks.data import data_of, long_enough
from residuum.identification.unseen_blocks.structure import States, fitted
from residuum.identification.unseen_blocks.tried import Search


@dataclass(frozen=True, eq=False)
class Split:
    """`training` records, and `testing` ones each with the sample from which it counts (0: the
    whole record).
    """

    training: list[Record]
    testing: list[tuple[Record, int]]

    @property
    def aside(self) -> str:
        """What is kept aside, in words."""
        spans = [
            (r.t0 + first * r.sample_time, r.t0 + r.n * r.sample_time, Path(r.source).name)
            for r, first in self.testing
        ]
        return ", ".join(
            f"{start:.4g} to {end:.4g} s of {name or 'the record'}" for start, end, name in spans
        )


def split(records: Sequence[Record]) -> Split:
    """Several records: every third is kept aside (of two, the second). One: its end, by its note
    `split: 0.7` or 30 %.

    A part in which the record stands still judges nothing: then the beginning is kept aside, or the
    middle.
    """
    if len(records) > 1:
        testing = [k for k in range(len(records)) if k % 3 == 2] or [len(records) - 1]
        return Split(
            [record for k, record in enumerate(records) if k not in testing],
            [(records[k], 0) for k in testing],
        )
    return _split_of_one(records[0])


def _split_of_one(record: Record) -> Split:
    """The end of a record, where it moves there; else its beginning, or its middle."""
    first = int(record.n * (record.split or TRAINING_SHARE))
    aside, middle = record.n - first, first // 2
    spans = [(first, record.n)]
    if record.split is None:  # what a user notes is never another part
        spans += [(0, aside), (middle, middle + aside)]
    begin, stop = next((span for span in spans if _moves(record, *span)), spans[0])
    if stop == record.n:
        # the whole record is simulated, so that its end begins where the rest led
        return Split([record.window(0, begin)], [(record, begin)])
    training = [record.window(stop, record.n)]
    if begin:
        training = [record.window(0, begin), *training]
    return Split(training, [(record.window(begin, stop), 0)])


def is_noted(records: Sequence[Record]) -> bool:
    """Whether a user says which part of a record is for training."""
    return any(record.split is not None for record in records)


def matched_at(
    model: PhysicalModel,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None,
    hold: FloatArray,
) -> tuple[PhysicalModel, list[Experiment]]:
    """`match` at an input timing that is known: `hold` (inputs,), 0 held and 1 moving evenly."""
    matched, experiments = match(model, records, mapping)
    return matched, [replace(e, hold=hold) for e in experiments]


def testing_of(
    model: PhysicalModel, parts: Split, mapping: Mapping[str, str] | None, hold: FloatArray
) -> list[tuple[Experiment, int]]:
    """What is kept aside as experiments, each with the sample from which it counts."""
    _, aside = matched_at(model, [record for record, _ in parts.testing], mapping, hold)
    return [(e, first) for e, (_, first) in zip(aside, parts.testing, strict=True)]


def _moves(record: Record, begin: int, stop: int) -> bool:
    """Whether every channel that changes in the record does so in this part of it too."""
    with np.errstate(invalid="ignore"):
        for values in record.channels.values():
            part = values[begin:stop]
            whole_spread = np.nanstd(values)
            part_spread = np.nanstd(part) if np.isfinite(part).any() else 0.0
            if whole_spread > 0.0 and part_spread < STANDS_STILL * whole_spread:
                return False
    return True


def rmse_aside(
    model: PhysicalModel,
    testing: Sequence[tuple[Experiment, int]],
    begins: Sequence[FloatArray] | None = None,
) -> FloatArray:
    """RMS simulation error of each output over the samples that count; ∞ where the model diverges.

    Initial states come from the samples before those that count, or where all count from the
    experiment itself; `begins` (states,) of each, where they are known, is where they are sought.
    """
    simulator, experiments = Simulator(model), [e for e, _ in testing]
    beginnings = [
        replace(e, Y=np.where(np.arange(e.n)[:, None] < first, e.Y, np.nan)) if first else e
        for e, first in testing
    ]
    states_alone = Settings(iterations=STATES_ITERATIONS, tolerance=STATES_TOLERANCE)
    try:
        start = estimate(model, beginnings, free=(), initial=begins, settings=states_alone)
    except NotIdentifiable:
        return np.full(len(model.outputs), np.inf)
    runs = simulator.run_each(experiments, start.initial, simulator.p(), substeps=start.substeps)
    joined = np.concatenate(
        [(e.Y - run.Y)[first:] for (e, first), run in zip(testing, runs, strict=True)]
    )
    count = np.isfinite(joined).sum(axis=0)
    return np.where(count > 0, np.sqrt(np.nansum(joined**2, axis=0) / np.maximum(count, 1)), np.nan)


# The last question to an improvement: does it simulate better what none of it was estimated on, the
# end of a record, or of several the most different one?
#
# Blocks between others are interpolated. Values that go astray outside of what was seen show at the
# end of a record, or on another one, so the model is estimated without it once more, with the
# effects and without them.


def first_that_holds(
    base: PhysicalModel,
    models: Sequence[PhysicalModel],
    search: Search,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None,
) -> int | None:
    """The first of the `models` that leaves no more error than `base` where data are kept aside: at
    the end, and on the most different record; nor over whole records, where they were judged in
    windows. None where none does; the first of all where the records are too short to ask.
    """
    splits = _kept_aside(records)
    if search.validation.last.windows > 1:
        # the first states of windows hide where a model goes in the long run
        splits.append(Split(list(records), [(record, 0) for record in records]))
    splits = [
        parts for parts in splits if parts.testing and long_enough([r.n for r in parts.training])
    ]
    limits = [KEPT_RISE * _error(base, search, parts, mapping) for parts in splits]
    for number, model in enumerate(models):
        if all(
            _error(model, search, parts, mapping) <= limit
            for parts, limit in zip(splits, limits, strict=True)
        ):
            return number
    return None


def _kept_aside(records: Sequence[Record]) -> list[Split]:
    """The usual part, and of several records the one that goes furthest beyond the others, where
    the usual part is not that, and the others are long enough beside it.
    """
    usual = split(records)
    if len(records) < 2:
        return [usual]
    # what a model learnt is asked where it has not been: beyond the range of the other records
    beyond = [
        _beyond(record, [peer for peer in records if peer is not record]) for record in records
    ]
    furthest = records[int(np.argmax(beyond))]
    others = [record for record in records if record is not furthest]
    # a short record of one movement tells no model what another, long one, goes on to
    too_little = sum(record.n for record in others) < LEAST_TO_LEARN_FROM * furthest.n
    if too_little or [record for record, _ in usual.testing] == [furthest]:
        return [usual]
    return [usual, Split(others, [(furthest, 0)])]


def _beyond(record: Record, peers: Sequence[Record]) -> float:
    """By how much a record's signals leave the range of the same signals of the others, in units of
    that range, at most.
    """
    far = 0.0
    for name, values in record.channels.items():
        known = [peer.channels[name] for peer in peers if name in peer.channels]
        peer_values = np.concatenate(known) if known else np.empty(0)
        if np.isfinite(values).any() and np.isfinite(peer_values).any():
            low, high = float(np.nanmin(peer_values)), float(np.nanmax(peer_values))
            out = max(low - float(np.nanmin(values)), float(np.nanmax(values)) - high)
            far = max(far, out / max(high - low, 1e-300))
    return far


def _error(
    model: PhysicalModel, search: Search, parts: Split, mapping: Mapping[str, str] | None
) -> float:
    """Simulation error over what is kept aside, estimated on the rest, the outputs in units of the
    first model's errors; infinite where it diverges.
    """
    hold, scale = search.validation.data.experiments[0].hold, search.validation.scale
    data = data_of(*matched_at(model, parts.training, mapping, hold))
    horizon = data.horizon(search.validation.last.windows)
    # From the measured states, and from those that the search found on its way over ever longer
    # windows: a link that turns over ends in another turn from a first angle a hundredth beside.
    fits = [
        fitted(data.model, horizon, states, scale, steps=20, tolerance=1e-5)
        for states in (None, _known(search, horizon.parts))
        if states is None or states
    ]
    estimated = min((fit for fit in fits if fit is not None), key=lambda f: f.cost, default=None)
    if estimated is None:
        return np.inf
    testing = testing_of(estimated.model, parts, mapping, hold)
    ends = {_begin(part): x for part, x in zip(horizon.parts, estimated.X0, strict=True)}
    begins = [ends[_begin(e)] for e, _ in testing if _begin(e) in ends]
    return scale.error(
        rmse_aside(estimated.model, testing, begins if len(begins) == len(testing) else None)
    )


def _known(search: Search, parts: Sequence[Experiment]) -> States:
    """The first states that the search found where these parts begin; none where it has not seen
    them all.
    """
    last = search.validation.last
    found = search.best.structure.states.get(last.windows)
    if found is None:
        return []
    states = dict(zip(map(_begin, last.parts), found, strict=True))
    known = [states[_begin(part)] for part in parts if _begin(part) in states]
    return known if len(known) == len(parts) else []


def _begin(part: Experiment) -> tuple[str, float]:
    """The record and the time at which a part begins."""
    return part.source, part.t0
