"""Advice: how large an effect would have had to be to be seen, and which experiment tells apart
what this one cannot.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from residuum.identification.errors import BadInput
from residuum.identification.physics import Experiment, Key, PhysicalModel, Simulator
from residuum.identification.physics.model import find_effect
from residuum.identification.side_by_side import side_by_side
from residuum.identification.unseen_blocks.following import Track
from residuum.identification.unseen_blocks.judged import Judged
from residuum.identification.unseen_blocks.next_experiment import (
    HELD,
    NextExperiment,
    distinguishing,
    power_of_test,
)
from residuum.identification.unseen_blocks.policy import SENSOR_NOISE, TIE, WORTH_SEPARATING
from residuum.identification.unseen_blocks.proposals import proposed, starts
from residuum.identification.unseen_blocks.scale import Scale, of_noise
from residuum.identification.unseen_blocks.tried import Search, Wanted
from residuum.identification.unseen_blocks.verdict import Candidate


@dataclass(frozen=True)
class Undetectable:
    """Smallest size of an effect's leading parameter that would have been accepted, in `unit`."""

    effect: str
    balance: str
    smallest_visible: dict[str, float]
    unit: str


def noise_of(judged: Judged, search: Search) -> Scale:
    """Nats of the noise that a structure leaves."""
    last = search.court.last
    return of_noise(np.split(judged.errors, last.starts[1:-1]), last, search.court.data.measured)


def undetectable(
    search: Search, wanted: Wanted, along: Track | None, named: Collection[Key]
) -> tuple[Undetectable, ...]:
    """For every effect with a size that is not `named`: the size s whose ½·I·s² nats would be
    enough.

    `named` are those that joined and what does the same in their place. I is the information on the
    size beside the free parameters, in the noise that the best structure leaves.
    """
    if along is None:
        return ()
    keys = [
        k
        for k in proposed(search.best.model, wanted.effects, None, learned=False, held=False)
        if k not in named
    ]
    keys = [key for key in keys if find_effect(key.effect).sizes]
    scale = noise_of(search.best, search)
    undetected = side_by_side(lambda key: _smallest(key, search, scale, along, len(keys)), keys)
    return tuple(effect for effect in undetected if effect is not None)


def _smallest(
    key: Key, search: Search, scale: Scale, along: Track, count: int
) -> Undetectable | None:
    effect = find_effect(key.effect)
    first = starts(key, along)
    if not first:
        return None
    size, start = effect.sizes[0], first[-1]
    try:
        model = search.best.model.with_effect(*key, effect.at_rest(start))
        at = model.effects[-1]
        information = _information(model, f"{at.label}.{size}", search, scale)
    except BadInput:
        return None
    if not information > 0.0:
        return None
    needed = (
        np.log(max(count, 1)) + TIE + scale.price * sum(not p.fixed for p in at.parameters.values())
    )
    return Undetectable(
        key.effect,
        key.target,
        {size: float(np.sqrt(2.0 * needed / information))},
        at.parameters[size].unit,
    )


def _information(model: PhysicalModel, name: str, search: Search, scale: Scale) -> float:
    """On one parameter, the free ones of the best structure projected out; none where they do all
    that it does, or its slopes grow without bounds.
    """
    last, simulator = search.court.last, Simulator(model)
    states = search.best.structure.states[last.windows]
    initial = [simulator.x0({n: v for n, v in s.items() if n in simulator.states}) for s in states]
    steps = search.best.structure.steps[last.windows]
    columns = [name, *search.best.model.free]
    runs = simulator.run_each(last.parts, initial, simulator.p(), slopes=columns, substeps=steps)
    if runs.dY is None or not runs.bounded:
        return 0.0
    with np.errstate(over="ignore", invalid="ignore"):
        J = scale.whitened(runs.dY * scale.weights[:, None], last.starts.tolist())
        J = J[:, scale.weights > 0.0].reshape(-1, len(columns))
        size = np.linalg.norm(J, axis=0)
    if not np.all(np.isfinite(size)):
        return 0.0
    Q, R = np.linalg.qr(J[:, 1:][:, size[1:] > 0.0] / size[1:][size[1:] > 0.0])
    Q = Q[:, np.abs(np.diag(R)) > 1e-9]
    residual = J[:, 0] - Q @ (Q.T @ J[:, 0])
    own = float(residual @ residual)
    return own if own > 1e-9 * float(size[0]) ** 2 else 0.0


def next_experiments(search: Search, candidates: Sequence[Candidate]) -> tuple[NextExperiment, ...]:
    """Extra sensors and other input profiles, best first, for the leading candidate and what it
    cannot be told from.

    Both structures are simulated; the difference of their signals in units of noise, what their own
    free parameters can absorb taken out, is the non-centrality of a χ² test that tells them apart.
    """
    pair = _rivals(search, candidates)
    if pair is None:
        return ()
    (key, first), (rival, second) = pair
    scale = noise_of(first, search)

    def power(experiments: Sequence[Experiment], only: int | None) -> float | None:
        return _power(first, second, experiments, scale, only)

    return distinguishing(
        (key.effect, rival.effect), first.model, search.court.data.experiments, power
    )


def _rivals(
    search: Search, candidates: Sequence[Candidate]
) -> tuple[tuple[Key, Judged], tuple[Key, Judged]] | None:
    if not candidates:
        return None
    first = candidates[0]
    rivals = [
        c
        for c in candidates[1:]
        if c.step == 0
        and (c.effect in first.indistinguishable_from or c.probability > WORTH_SEPARATING)
    ]
    alone = {
        key: judged
        for (key, *more), judged in ((k, o) for k, o in search.every.items() if k)
        if not more
    }
    rival = next((c for c in rivals if c.key in alone and c.key != first.key), None)
    if rival is None or first.key not in alone or rival.key.effect == HELD:
        return None
    return (first.key, alone[first.key]), (rival.key, alone[rival.key])


def _power(
    a: Judged, b: Judged, experiments: Sequence[Experiment], scale: Scale, only: int | None
) -> float | None:
    """Power of the test on what the second structure's parameters cannot absorb; None when it could
    not be simulated.
    """
    simulator_a, two = Simulator(a.model), Simulator(b.model)
    rows, slopes = [], []
    for e in experiments:
        x = simulator_a.run_vectors(e, simulator_a.x0(_first(a)), simulator_a.p()).Y
        run = two.run_vectors(e, two.x0(_first(b)), two.p(), slopes=b.model.free)
        if run.dY is None or not (np.all(np.isfinite(x)) and run.finite):
            return None
        weights = scale.weights.copy()
        if only is not None:
            weights[only] = 1.0 / (
                SENSOR_NOISE * max(float(np.sqrt(np.mean(x[:, only] ** 2))), 1e-300)
            )
        rows.append(scale.whitened((x - run.Y) * weights, [0, e.n]).ravel())
        slopes.append(
            scale.whitened(run.dY * weights[:, None], [0, e.n]).reshape(-1, run.dY.shape[2])
        )
    return power_of_test(np.concatenate(rows), np.concatenate(slopes))


def _first(judged: Judged) -> dict[str, float]:
    """First states of the first window on the last rung; those that it fixes stay."""
    states = judged.structure.states[min(judged.structure.states)]
    return dict(states[0])
