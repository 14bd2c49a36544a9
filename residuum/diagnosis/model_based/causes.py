"""Which cause: one posterior over everything that may have happened to the machine, its sensors and its actuators.

Each hypothesis' evidence is the rise of the innovations' likelihood with its best size, less half the logarithm of the number of
samples for each size (Schwarz), under the covariance that healthy windows have; kinds are equally likely before the window was
seen, and within a kind its members. Members whose likelihoods lie within a factor of twenty cannot be told apart by the window:
they are a group, which shares its probability. What no hypothesis explains, though all sizes together do, is unknown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from residuum.diagnosis.model_based.baseline import Baseline
from residuum.diagnosis.model_based.detection import chi_square, log_energy
from residuum.diagnosis.model_based.filter_causes import filter_causes
from residuum.diagnosis.model_based.hypotheses import Column, Hypothesis
from residuum.diagnosis.model_based.reading_faults import Run, lost_readings, stands, stuck
from residuum.diagnosis.model_based.settled_sizes import settled
from residuum.diagnosis.model_based.sizes import Sized, Window, refined, with_onset

Array = npt.NDArray[np.float64]

_WEIGHED = {"parameter": 0.3, "effect": 0.25, "sensor": 0.25, "actuator": 0.1, "disturbance": 0.08, "unknown": 0.02}
_REFINED, _REFINED_WHEN_STRONG = 4, 9
"""Hypotheses whose size is re-estimated; and where the change is so strong that a first-order rise says little of it."""
_STRONG = 150.0
"""First-order rise of the log-likelihood from which on it is."""
_NEAR = 0.5
"""Share of the largest first-order rise from which on a hypothesis is re-estimated."""
TOLD_APART = 3.0
"""Log-likelihood by which one must lie ahead of another to be told from it: a factor of twenty."""
_OF_EVIDENCE = 0.02
"""… and by this share of its own: no model is exact, and what a large change leaves over decides between causes at random."""
_OF_NOISE = 0.5
"""Share of the samples that a growth of noise is told by: what has any structure is told by its structure."""
_EXPLAINED = 0.7
"""Share of what all sizes together explain with which a single cause is preferred to an unknown one: no model is exact."""
_BY_CHANCE = 4.0
"""Standard deviations of chance that the energy which the first cause leaves over must pass, to be more than that."""
_BEYOND = 3.0
"""Half-widths of a bound by which a size may lie outside before the hypothesis is dropped, in standard deviations."""


@dataclass(frozen=True, eq=False)
class Cause:
    """One hypothesis with its probability, its size (its first column's; `sizes` are all), and what it cannot be told from."""

    kind: str
    name: str
    place: str
    evidence: float
    value: float | None = None
    std: float | None = None
    unit: str = ""
    onset: int = 0
    size: int | None = None
    probability: float = 0.0
    alike: tuple[str, ...] = ()
    columns: tuple[Column, ...] = field(default=())
    sizes: tuple[float, ...] = ()

    @property
    def label(self) -> str:
        """`name@place`, or the name alone."""
        return f"{self.name}@{self.place}" if self.place else self.name


def causes(baseline: Baseline, window: Window) -> list[Cause]:
    """All causes that come near, the likeliest first, with those that none can be told from named."""
    found = [*_from_readings(baseline, window), *_from_sizes(baseline, window), _unknown(baseline, window)]
    ranked = _posterior(found, baseline)
    if ranked and _asks_the_filter(baseline, window, ranked[0]):
        found = [cause for cause in found if (cause.kind, cause.name) != ("sensor", "noise")]
        ranked = _posterior([*found, *_from_filters(baseline, window)], baseline)
    first = {ranked[0].label, *ranked[0].alike} if ranked else set()
    return [_settled(baseline, window, cause) if cause.label in first else cause for cause in ranked]


def _asks_the_filter(baseline: Baseline, window: Window, first: Cause) -> bool:
    """Whether no structure explains the window: then noise, a random load and a second body are given filters of their own."""
    if first.kind == "unknown" or (first.kind, first.name) == ("sensor", "noise"):
        return True
    usual = 0.5 * float(np.sum(window.sums.count * np.exp(baseline.energies.mean)))
    beyond = -window.likelihood(window.rows, baseline.scatter.scale) - usual
    by_chance = _BY_CHANCE * float(np.sqrt(0.5 * _samples(window)))
    return first.value is not None and beyond - first.evidence > max((1.0 - _EXPLAINED) * beyond, by_chance)


def _from_filters(baseline: Baseline, window: Window) -> list[Cause]:
    penalty = 0.5 * np.log(max(_samples(window), 2.0))
    return [
        Cause(c.kind, c.name, c.place, c.gain - penalty * c.sizes, c.value, c.std, c.unit)
        for c in filter_causes(baseline, window)
    ]


def _settled(baseline: Baseline, window: Window, cause: Cause) -> Cause:
    """The cause with its size told where it is; as it was where it has none, or where the filter cannot follow it there."""
    if cause.size is None:
        return cause
    h = next(h for h, g in zip(baseline.hypotheses, baseline.groups, strict=True) if g.sizes[0] == cause.size)
    found = settled(baseline, window, h, np.array(cause.sizes), cause.onset)
    if found is None:
        return cause
    return replace(cause, value=float(found[0][0]), std=float(found[1][0]), sizes=tuple(found[0].tolist()))


def _samples(window: Window) -> float:
    return float(np.sum(window.sums.count))


def _from_sizes(baseline: Baseline, window: Window) -> list[Cause]:
    first = [(0.5 * chi_square(window.judged, g.sizes), k) for k, g in enumerate(baseline.groups)]
    penalty = 0.5 * np.log(max(_samples(window), 2.0))
    first.sort(key=lambda item: -(item[0] - penalty * len(baseline.groups[item[1]].sizes)))
    largest = max(gain for gain, _ in first)
    near = [(gain, k) for gain, k in first if gain > _NEAR * largest - TOLD_APART]
    refined_first = _REFINED if largest < _STRONG else _REFINED_WHEN_STRONG
    found = []
    for rank, (_, k) in enumerate(near):
        h, group = baseline.hypotheses[k], baseline.groups[k]
        size = refined(baseline, window, h, group.sizes, steps=4 if rank < refined_first else 0)
        if rank < refined_first:
            size = with_onset(baseline, window, h, size)
        if _possible(window, h, size):
            found.append(_cause(h, size, group.sizes[0], size.gain - penalty * len(group.sizes)))
    return found


def _cause(h: Hypothesis, s: Sized, size: int, evidence: float) -> Cause:
    value, std, sizes = float(s.value[0]), float(s.std[0]), tuple(s.value.tolist())
    return Cause(h.kind, h.name, h.place, evidence, value, std, h.columns[0].unit, s.onset, size, columns=h.columns, sizes=sizes)


def _possible(window: Window, h: Hypothesis, s: Sized) -> bool:
    """Within its bounds, or not clearly outside: a friction that drives is none."""
    for column, value, std in zip(h.columns, s.value, s.std, strict=True):
        now = 0.0
        if column.acts_on.startswith("parameter:"):
            now = window.values[column.acts_on.removeprefix("parameter:")]
        if not column.lower - _BEYOND * std <= now + value <= column.upper + _BEYOND * std:
            return False
    return True


def _from_readings(baseline: Baseline, window: Window) -> list[Cause]:
    """What a sensor shows by itself: stuck, drop-out, noise."""
    found: list[Cause] = []
    filtered, left = window.filtered, energies_left(baseline, window)
    penalty = 0.5 * np.log(max(_samples(window), 2.0))
    for o, (name, output) in enumerate(baseline.tracking.model.outputs.items()):
        y = filtered.experiment.Y[:, o]
        if not np.isfinite(y).any():
            continue
        own = 0.5 * float(window.sums.energy[o] - window.sums.count[o] * np.exp(baseline.energies.mean[o]))
        everything = 0.5 * float(np.sum(window.sums.energy) - np.sum(window.sums.count * np.exp(baseline.energies.mean)))
        run = stuck_at(baseline, window, o)
        if run is not None:
            found.append(Cause("sensor", "stuck", name, everything, run.value, 0.0, output.unit, run.first))
        lost = lost_readings(np.nan_to_num(y), float(np.sqrt(np.nanmedian(filtered.V[:, o]))))
        if run is None and lost.any():
            share = float(np.mean(lost))
            found.append(Cause("sensor", "drop-out", name, max(own, everything), share, 0.0, "1", int(np.argmax(lost))))
        ratio = float(left[o] / max(window.sums.count[o], 1.0) / np.exp(baseline.energies.mean[o]))
        if ratio > 1.0:
            n = _OF_NOISE * float(window.sums.count[o])
            gain = 0.5 * n * (ratio - 1.0 - np.log(ratio))
            std = float(np.sqrt(filtered.V[np.isfinite(y), o].mean()) * np.sqrt(ratio))
            found.append(Cause("sensor", "noise", name, gain - penalty, std, std / np.sqrt(2.0 * n), output.unit, 0))
    return found


def energies_left(baseline: Baseline, window: Window) -> Array:
    """Energy of each output's whitened innovations less what all sizes, weighted by what is usual, explain, shape (outputs,)."""
    scatter = baseline.scatter
    g = (window.white.T @ window.rows) * scatter.scale
    about = g - (window.sums.A * scatter.scale[:, None] * scatter.scale) @ window.mean
    likely = window.mean + window.weights @ about
    rest = (window.rows - window.white @ (scatter.scale * likely)).reshape(len(baseline.colours), -1)
    return np.asarray(np.sum(rest**2, axis=1))


def stuck_at(baseline: Baseline, window: Window, output: int) -> Run | None:
    """The run in which an output's reading stands although the machine moved; None where it does not."""
    filtered = window.filtered
    y = filtered.experiment.Y[:, output]
    if not stands(y, int(baseline.usual.runs[output])):
        return None
    expected = without_reading(baseline, window, output)
    noise = float(np.sqrt(np.nanmedian(filtered.V[:, output])))
    floor = max(noise, 0.02 * float(baseline.usual.spans[output]))
    return stuck(y, expected, floor, int(baseline.usual.runs[output]))


def without_reading(baseline: Baseline, window: Window, output: int) -> Array:
    """What the output was expected to read, had its sensor not been asked."""
    e = window.filtered.experiment
    Y = e.Y.copy()
    Y[:, output] = np.nan
    tracking = baseline.tracking
    filtered = tracking.run(replace(e, Y=Y), slopes=False)
    if not np.all(np.isfinite(filtered.after)):
        return np.full(e.n, np.nan)
    return tracking.simulator.look_outputs(e, tracking.states(filtered))[:, output]


def _unknown(baseline: Baseline, window: Window) -> Cause:
    """All own sizes at once, each paid for; and energy that no size explains."""
    own = baseline.scatter.own.tolist()
    penalty = 0.5 * np.log(max(_samples(window), 2.0))
    seen = [k for k in own if window.judged.information[k, k] > 1e-9]
    ratio = float(np.max(np.exp(log_energy(window.sums) - baseline.energies.mean)))
    gain = _EXPLAINED * 0.5 * chi_square(window.judged, seen) / max(ratio, 1.0) ** 0.5 if seen else 0.0
    return Cause("unknown", "unknown", "", gain - penalty * len(seen))


def _posterior(found: Sequence[Cause], baseline: Baseline) -> list[Cause]:
    """Probabilities, shared within groups of causes that cannot be told apart; a cause at several shapes counts once."""
    best: dict[tuple[str, str, str], Cause] = {}
    for cause in found:
        key = (cause.kind, cause.name, cause.place)
        if key not in best or cause.evidence > best[key].evidence:
            best[key] = cause
    members: dict[str, int] = {}
    for h in {(h.kind, h.name, h.place) for h in baseline.hypotheses}:
        members[h[0]] = members.get(h[0], 0) + 1
    members["sensor"] = members.get("sensor", 0) + 3 * len(baseline.tracking.model.outputs)
    weights = {
        key: cause.evidence + float(np.log(_WEIGHED[cause.kind] / max(members.get(cause.kind, 1), 1)))
        for key, cause in best.items()
    }
    top = max([0.0, *weights.values()])
    total = float(np.exp(-top) + sum(np.exp(w - top) for w in weights.values()))
    ranked = sorted(best, key=lambda key: -weights[key])
    grouped: list[Cause] = []
    taken: set[tuple[str, str, str]] = set()
    for key in ranked:
        if key in taken:
            continue
        apart = max(TOLD_APART, _OF_EVIDENCE * best[key].evidence)
        group = [
            other for other in ranked if other not in taken and best[key].evidence - best[other].evidence < apart
            and best[key].kind != "unknown" and (other == key or best[other].kind != "unknown")
        ] or [key]  # fmt: skip
        taken |= set(group)
        shared = float(sum(np.exp(weights[other] - top) for other in group)) / total / len(group)
        grouped += [_in_group(best[other], [best[o] for o in group], shared) for other in group]
    return [cause for cause in grouped if cause.probability > 1e-3]


def _in_group(cause: Cause, group: Sequence[Cause], probability: float) -> Cause:
    alike = tuple(other.label for other in group if other is not cause)
    return replace(cause, probability=probability, alike=alike)
