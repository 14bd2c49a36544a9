"""Physics that healthy windows show too, but the model does not have: added for the time being, so that it hides no fault."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.diagnosis.model_based.healthy_values import HealthyValues, healthy_values, value_columns
from residuum.diagnosis.model_based.hypotheses import Hypothesis, Signals, hypotheses, slopes_of
from residuum.diagnosis.model_based.window_statistics import colours, statistics
from residuum.identification.errors import BadInput
from residuum.identification.physics import Experiment, PhysicalModel
from residuum.identification.physics.effects import EFFECTS
from residuum.identification.physics.estimation.least_squares import solve_scaled

Array = npt.NDArray[np.float64]

_MOST = 3
_WORTH = 40.0
"""Rise of the log-likelihood that an effect must bring, when all is estimated anew."""
_SAME_SIGN = 4.0
"""Standard errors, of the windows' scatter, by which its mean size must differ from zero."""
_TRIED = 3


@dataclass(frozen=True)
class StandIn:
    """An effect that healthy windows show beyond the user's model: its label, and by how much the log-likelihood rose."""

    label: str
    gain: float


def with_missing_physics(
    values: HealthyValues, experiments: Sequence[Experiment], free: Sequence[str]
) -> tuple[HealthyValues, list[StandIn]]:
    """Effects of the catalogue joined one after the other, each if the healthy windows ask for it, all values estimated anew."""
    found: list[StandIn] = []
    while len(found) < _MOST:
        for candidate in _promising(values):
            try:
                model = _with(values.tracking.model, candidate[0], candidate[1])
                sizes = [f"{model.effects[-1].label}.{name}" for name in EFFECTS[candidate[0].name].sizes]
                trial = healthy_values(model, experiments, [*values.free, *sizes], values.tracking)
            except BadInput:
                continue
            gain = trial.log_likelihood - values.log_likelihood
            if gain > _WORTH and not _at_bound(trial.tracking.model, sizes):
                values = _settled(trial, experiments)
                found.append(StandIn(model.effects[-1].label, gain))
                break
        else:
            break
    return values, found


def _settled(values: HealthyValues, experiments: Sequence[Experiment]) -> HealthyValues:
    """Noise and values estimated anew: what the effect now explains was noise before."""
    try:
        return healthy_values(values.tracking.model, experiments, values.free)
    except BadInput:
        return values


def _with(model: PhysicalModel, h: Hypothesis, sizes: Array) -> PhysicalModel:
    """The model with the effect at these sizes, its other parameters held at their shape."""
    names = [c.signal.partition(":")[2] for c in h.columns]
    start = dict(h.shape) | {
        name: float(np.clip(size, c.lower, c.upper)) for name, size, c in zip(names, sizes, h.columns, strict=True)
    }
    return model.with_effect(h.name, h.place, start, fixed=[name for name in start if name not in names])


def _at_bound(model: PhysicalModel, names: Sequence[str]) -> bool:
    """Whether all sizes vanish or lie on a bound: then it is none, or another effect in disguise."""
    known = model.all_parameters
    return all(known[n].value in (known[n].lower, known[n].upper, 0.0) for n in names)


def _promising(values: HealthyValues) -> list[tuple[Hypothesis, Array]]:
    """The few effects that explain most over all windows, the free values re-estimated with each, and their sizes."""
    tracking, windows = values.tracking, values.windows
    listed = [h for h in hypotheses(tracking.model, tracking, windows) if h.shape or h.kind in ("parameter", "effect")]
    signals = Signals(tracking.model, listed)
    J = [slopes_of(w, tracking, listed, signals.of(w, tracking.states(w))) for w in windows]
    colour = colours(windows, J, *value_columns(tracking.model, listed))
    sums = [statistics(w, j, colour) for w, j in zip(windows, J, strict=True)]
    A, g = np.sum([s.A for s in sums], axis=0), np.sum([s.g for s in sums], axis=0)
    starts = np.concatenate([[0], np.cumsum([len(h.columns) for h in listed])])
    known = [k for k, h in enumerate(listed) if not h.shape]
    free = [int(c) for k in known for c in range(starts[k], starts[k + 1])]
    ranked = []
    for k, h in enumerate(listed):
        if not h.shape:
            continue
        own = list(range(starts[k], starts[k + 1]))
        absorbed = solve_scaled(A[np.ix_(free, free)], A[np.ix_(free, own)]) if free else np.zeros((0, len(own)))
        left = A[np.ix_(own, own)] - A[np.ix_(own, free)] @ absorbed
        sizes = solve_scaled(left, (g[own] - absorbed.T @ g[free])[:, None], 1e-9)[:, 0]
        chi_square = float(sizes @ left @ sizes)
        inside = all(c.lower <= b <= c.upper for b, c in zip(sizes, h.columns, strict=True))
        each = np.array([(s.g[own] - absorbed.T @ s.g[free]) @ sizes for s in sums])
        steady = float(each.mean() / (each.std(ddof=1) / np.sqrt(len(each)) + 1e-300)) if len(each) > 2 else np.inf
        if inside and chi_square > 2.0 * _WORTH and steady > _SAME_SIGN:
            ranked.append((chi_square - 2.0 * len(own), k, h, sizes))
    ranked.sort(key=lambda r: -r[0])
    seen: list[tuple[Hypothesis, Array]] = []
    for _, _, h, sizes in ranked:
        if (h.name, h.place) not in [(other.name, other.place) for other, _ in seen]:
            seen.append((h, sizes))
    return seen[:_TRIED]
