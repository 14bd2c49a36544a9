"""Missing physics of a watched machine: what its model lacks in healthy windows, each at values of its own.

Over all windows together the scatter of values hides it. So it is sought in single windows by the judge of missing physics, and
kept where it takes error away in the others as well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residuum.array_types import FloatArray
from residuum.diagnosis.model_based.baseline import alone
from residuum.diagnosis.model_based.policy import ALWAYS, CALIBRATED, NO_ERROR, OPEN, SEARCH, SEARCHED
from residuum.diagnosis.model_based.whitening import Whitening
from residuum.diagnosis.model_based.window_fit import Fit, information
from residuum.identification.errors import BadRecord, NotIdentifiable
from residuum.identification.physics import Experiment, Key, PhysicalModel
from residuum.identification.physics.effects.base import Parameter
from residuum.identification.residual_analysis.input_timing import turned_timing
from residuum.identification.unseen_blocks.data import data_of
from residuum.identification.unseen_blocks.search import search
from residuum.identification.unseen_blocks.tried import Search, Wanted
from residuum.identification.unseen_blocks.verdict import is_timing
from residuum.identification.work import at_most


@dataclass(frozen=True, eq=False)
class _Mended:
    """A model, how its inputs move between samples, and its fit to each window at the window's own values."""

    model: PhysicalModel
    windows: Sequence[Experiment]
    fits: Sequence[Fit | None]

    @property
    def log_errors(self) -> FloatArray:
        """Mean over the outputs of the logarithm of the RMS error in each window, in the model's over all of them; infinite where
        it diverges.

        An error a thousand times smaller is none: in a window in which nothing moves any error can be taken away.
        """
        there = self.windows[0].measured
        power = [None if f is None else f.power.mean(axis=0) for f in self.fits]
        return np.array([np.inf if p is None else 0.5 * np.mean(np.log(p + NO_ERROR**2), where=there) for p in power])

    @property
    def told(self) -> FloatArray:
        """What each window tells of the values, shape (windows, values, values): 0 where the model diverges."""
        count = len(self.model.free)
        return np.array([np.zeros((count, count)) if f is None else information(f, count) for f in self.fits])


def mended(model: PhysicalModel, windows: Sequence[Experiment], whitening: Whitening) -> tuple[PhysicalModel, list[Experiment]]:
    """The model with what healthy windows lack beside it, and the windows at the input timing that suits it. Both stay as they
    are where nothing is lacking in all of them.

    Values of new effects that the windows leave open are held.
    """
    few = [windows[k] for k in evenly(len(windows), CALIBRATED)]
    base = _fitted(model, few, whitening)
    searched = np.argsort(-_telling(base), kind="stable")[:SEARCHED]
    found = [_fitted(*one, whitening) for one in _lacking(model, few, searched.tolist())]
    errors = [one.log_errors for one in found]
    better = [k for k, error in enumerate(errors) if _falls(base.log_errors - error)]
    if not better:
        return model, list(windows)
    best = min(better, key=lambda k: float(errors[k].mean()))
    alike = [k for k in better if k == best or not _falls(errors[k] - errors[best], 1.0)]
    chosen = found[min(alike, key=lambda k: (len(found[k].model.free), float(errors[k].mean())))]
    return _settled(chosen, model), [replace(e, hold=chosen.windows[0].hold) for e in windows]


def held(model: PhysicalModel, names: Sequence[str]) -> PhysicalModel:
    """The model with these values, by full name, no longer free."""
    effects = tuple(replace(use, parameters=_fixed(use.parameters, names, f"{use.label}.")) for use in model.effects)
    return replace(model, parameters=_fixed(model.parameters, names), effects=effects)


def _fixed(parameters: Mapping[str, Parameter], names: Sequence[str], prefix: str = "") -> dict[str, Parameter]:
    return {name: replace(p, fixed=p.fixed or prefix + name in names) for name, p in parameters.items()}


def evenly(windows: int, count: int) -> list[int]:
    """So many windows, evenly over all of them."""
    return np.unique(np.linspace(0, windows - 1, count + 2)[1:-1].round().astype(int)).tolist()


def _telling(base: _Mended) -> FloatArray:
    """How much each window tells of the values, shape (windows,): the geometric mean of the information on each of them."""
    told = np.nan_to_num(np.diagonal(base.told, axis1=1, axis2=2))
    return np.asarray(np.log(np.maximum(told, 1e-12 * told.max(axis=0, initial=0.0)) + 1e-300).sum(axis=1))


def _lacking(
    model: PhysicalModel, windows: Sequence[Experiment], searched: Sequence[int]
) -> list[tuple[PhysicalModel, Sequence[Experiment]]]:
    """The model with what one of the windows that are searched lacks, at either input timing of all windows."""
    found: dict[tuple[Key, ...], list[tuple[PhysicalModel, Sequence[Experiment]]]] = {}
    for k in searched:
        try:
            with at_most(SEARCH):
                there = search(data_of(model, [windows[k]]), Wanted(held=False))
        except (BadRecord, NotIdentifiable):
            continue
        one = _physics(there)
        keys = tuple(use.key for use in one.effects)
        if len(keys) > len(model.effects) and keys not in found:
            found[keys] = [(one, windows), (one, turned_timing(windows))]
    return [each for both in found.values() for each in both]


def _physics(found: Search) -> PhysicalModel:
    """The best model without shifts in time by less than a sample: those are how records were taken."""
    model = found.best.model
    for use in found.best.model.effects:
        if use.key in found.best.keys and is_timing(use.key, found):
            model = model.without_effect(use.label)
    return model


def _fitted(model: PhysicalModel, windows: Sequence[Experiment], whitening: Whitening) -> _Mended:
    start = np.array([model.values[name] for name in model.free])
    return _Mended(model, windows, [alone(model, window, start, whitening) for window in windows])


def _settled(found: _Mended, before: PhysicalModel) -> PhysicalModel:
    """At the middle of the windows' values, each weighing as much as it tells; of new effects held are shapes, which no window
    changes, and what they leave open.
    """
    names, there = list(found.model.free), [fit is not None for fit in found.fits]
    each = found.told[there]
    values = _middle(np.array([fit.others for fit in found.fits if fit is not None]), np.diagonal(each, axis1=1, axis2=2))
    total = each.sum(axis=0)
    std = np.sqrt(np.diag(np.linalg.pinv(total, hermitian=True)))
    told = (np.diag(total) > 0.0) & (std < OPEN * np.abs(values))
    shapes = {
        f"{use.label}.{p}" for use in found.model.effects if use.effect.sizes for p in use.parameters if p not in use.effect.sizes
    }
    new = [name for name, there in zip(names, told, strict=True) if name not in before.free and (name in shapes or not there)]
    return held(found.model.with_values(dict(zip(names, values.tolist(), strict=True))), new)


def _middle(values: FloatArray, weights: FloatArray) -> FloatArray:
    """The weighted median over the rows."""
    order = np.argsort(values, axis=0, kind="stable")
    below = np.cumsum(np.take_along_axis(weights + 1e-300, order, axis=0), axis=0)
    at = np.argmax(below >= 0.5 * below[-1], axis=0)
    return np.asarray(np.take_along_axis(values, np.take_along_axis(order, at[None], axis=0), axis=0)[0])


def _falls(gain: FloatArray, times: float = ALWAYS) -> bool:
    """Whether the error falls in windows by more than so many standard errors."""
    return bool(np.isfinite(gain).all() and gain.mean() > times * gain.std(ddof=1) / np.sqrt(len(gain)))
