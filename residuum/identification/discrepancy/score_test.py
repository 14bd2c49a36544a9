"""Screening: what would each effect explain, to first order, after the free parameters have explained what they can?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.in_blocks import Sampled, at_every_sample, in_blocks
from residuum.identification.discrepancy.innovations import Noises, fit_noises, pointwise_log_likelihood
from residuum.identification.discrepancy.side_by_side import side_by_side
from residuum.identification.discrepancy.structures import COARSER, NOISE_ALONE, Structure, times_its_innovations
from residuum.identification.discrepancy.track import regressed, track
from residuum.identification.discrepancy.whitened_least_squares import RIDGE, NormalEquations, Stacked
from residuum.identification.errors import BadInput
from residuum.identification.physics import Experiment, PhysicalModel, Simulator, conditions_at
from residuum.identification.physics.effects.base import Conditions, Effect
from residuum.identification.physics.estimate.least_squares import solve_scaled
from residuum.identification.physics.model import find_effect

FloatArray = npt.NDArray[np.float64]

_WORTH_A_PASS = 2.0
"""Gain or loss of log-likelihood from which on a second pass, with the noise of the first, may matter."""
_HOPELESS = 100.0
"""Log-likelihood below the base's, under its noise, from which on no other noise is tried."""
_NOTHING = 2.0
"""Gain of log-likelihood under the base's noise up to which it is left."""
FAR_BEHIND = 20.0
"""Log-likelihood below the base's, after its first-order step, from which on an effect is hopeless beside noise alone."""
_FRACTIONS = (1.0, 0.3, 0.1, 0.03)
_MOVED = 1e-6
"""Part of the errors by which an effect at rest may change the outputs, by rounding."""
_FALLEN = 0.98
"""Share of the base's errors to which a step in white noise has to take them to be followed."""


_Fitted = tuple[FloatArray, FloatArray, list[FloatArray], Noises]
"""Step, pointwise log-likelihood, residuals and their noise after it."""
_Linear = tuple[list[FloatArray], list[FloatArray], list[FloatArray]]
"""Per experiment: residuals (blocks, outputs), and their slopes by parameters and by initial states."""


@dataclass(frozen=True, eq=False)
class Screened:
    """One candidate (effect, target) at one first shape.

    Attributes
    ----------
    start : PhysicalModel
        With the effect at the values the first-order step suggests (within bounds).
    gain : float
        First-order log-likelihood gain over the base, noise colour re-estimated.
    chi_square : float
        Score statistic under the base's noise: expected ½·that is the gain while the effect is small.
    information : float
        On the effect's leading parameter under the base's noise, all that is free projected out [1/unit²].
    own_parameters : int
        How many parameters the effect adds.
    own : tuple of str
        Its parameters that were free in the test; `slopes` those of the outputs by them, (blocks, outputs, own) an experiment.
    """

    effect: str
    target: str
    start: PhysicalModel
    gain: float
    chi_square: float
    information: float
    own_parameters: int
    own: tuple[str, ...]
    slopes: list[FloatArray]

    @property
    def key(self) -> tuple[str, str]:
        """(effect id, target)."""
        return self.effect, self.target


class Screen:
    """Score tests of candidates against one fitted structure.

    Each candidate is linearised where it vanishes (at a start of its own where it has no zero). The base's free parameters and
    every experiment's initial states are free in the same linear least squares, whitened; the noise is re-estimated from
    what remains, beginning from white noise and from the base's (the likelihood has a basin near each).

    The machine is tracked, and effects are regressed on that, with the model `origin`: the base's unless its values are not
    to be trusted. `refitted` are the starts that were re-estimated in full.
    """

    def __init__(self, base: Structure, experiments: Sequence[Experiment], origin: PhysicalModel | None = None) -> None:
        self.base, self.experiments = base, list(experiments)
        self.origin = base.model if origin is None else origin
        self.every = at_every_sample(base, self.experiments)
        self.coarse = in_blocks(self.every)
        self.track = track(self.origin, base, self.experiments, self.every.X)
        self.refitted: list[PhysicalModel] = []
        self._may_fall, self._noise_alone = _may_fall(base), times_its_innovations(base) < NOISE_ALONE
        self._conditions: dict[tuple[str, str], Conditions] = {}
        self._tested: dict[tuple[str, str], list[Screened]] = {}

    def where(self, model: PhysicalModel) -> Sampled:
        """Where a model's last effect is looked at first: once a block, if that shows it."""
        return self.every if find_effect(model.effects[-1].id).every_sample else self.coarse

    def starts(self, id: str, target: str) -> Sequence[dict[str, float]]:
        """First values of an effect's parameters in the conditions of the experiments."""
        effect, found = find_effect(id), []
        for missing in self._lacks(effect, target):
            conditions = replace(self.conditions(effect, target), missing=missing)
            found += [dict(start) for start in effect.starts(conditions)]
        return [start for k, start in enumerate(found) if start not in found[:k]]

    def conditions(self, effect: Effect, target: str) -> Conditions:
        """The conditions for an effect along the track."""
        if (effect.place, target) not in self._conditions:
            there = conditions_at(self.origin, effect, target, self.track.experiment, self.track.X)
            self._conditions[effect.place, target] = there
        return self._conditions[effect.place, target]

    def _lacks(self, effect: Effect, target: str) -> Sequence[FloatArray | None]:
        """What is missing, at the samples of the track, in each way in which the effect's first values follow it."""
        found: list[FloatArray] = []
        for what in effect.follows:
            found += [self.track.missing[target]] if what == "lack" else self._left(innovations=what == "innovations")
        return found or [None]

    def _left(self, *, innovations: bool) -> list[FloatArray]:
        """The error of each measured output, or what the base's noise cannot predict of it."""
        found = []
        for o, noise in enumerate(self.base.noises):
            if noise is not None:
                errors = [residuals[:, o] for residuals in self.base.residuals]
                if innovations:
                    errors = [np.r_[np.zeros(noise.order), noise.whiten(error)] for error in errors]
                found.append(np.concatenate([_repeated(v, e) for e, v in zip(self.experiments, errors, strict=True)]))
        return found

    def regressed(self, id: str, target: str) -> tuple[float, PhysicalModel] | None:
        """The effect at the sizes and the start that explain most of what its balance lacked along the track, and that share."""
        if not any(map(np.any, self.track.missing.values())):
            return None
        tried = [regressed(self.origin, id, target, start, self.track) for start in self.starts(id, target)]
        return max((found for found in tried if found is not None), key=lambda found: found[0], default=None)

    def best(self, id: str, target: str) -> Screened | None:
        """The candidate at the start that explains most; None when it diverges at every start."""
        return max(self.tests(id, target), key=lambda s: s.gain, default=None)

    def tests(self, id: str, target: str) -> list[Screened]:
        """The candidate at every start where it does not diverge; each is tested once."""
        self.test_all([(id, target)])
        return self._tested[id, target]

    def test_all(self, pairs: Sequence[tuple[str, str]]) -> None:
        """Test several candidates side by side at every start of theirs."""
        new = [pair for pair in pairs if pair not in self._tested]
        starts = {pair: self.starts(*pair) for pair in new}
        in_turn = [
            pair for pair in new if self._noise_alone and not (find_effect(pair[0]).vanishes and find_effect(pair[0]).rest == 0.0)
        ]
        pieces = [(pair, starts[pair]) for pair in in_turn]
        pieces += [(pair, [start]) for pair in new if pair not in in_turn for start in starts[pair]]
        self._tested |= {pair: [] for pair in new}
        for (pair, _), tested in zip(pieces, side_by_side(lambda piece: self._in_turn(*piece), pieces), strict=True):
            self._tested[pair] += tested

    def _in_turn(self, pair: tuple[str, str], starts: Sequence[dict[str, float]]) -> list[Screened]:
        """The candidate at those of several starts where it does not diverge, that which simulates best first, until one is
        hopeless: beside noise alone those that simulate worse are too.
        """
        found = []
        for start in sorted(starts, key=lambda start: self.error(self._at(*pair, start))) if len(starts) > 1 else starts:
            screened = self.test(*pair, start)
            found += [] if screened is None else [screened]
            if len(starts) > 1 and screened is not None and screened.gain < -FAR_BEHIND:
                break
        return found

    def not_refitted(self, starts: Sequence[PhysicalModel]) -> list[PhysicalModel]:
        """Those of the starts that were not re-estimated in full yet."""
        return [start for start in starts if not any(start is one for one in self.refitted)]

    def promising(self, id: str, target: str, most: int = 3) -> list[Screened]:
        """The candidate at its few starts that explain most, to first order or by what its simulation there leaves."""
        found = self.tests(id, target)
        by_gain = sorted(found, key=lambda s: -s.gain)
        by_error = sorted(found, key=lambda s: self.error(s.start))
        return list(dict.fromkeys([by_gain[k] for k in range(min(most, len(found)))] + by_error[:1]))

    def test(self, id: str, target: str, start: dict[str, float]) -> Screened | None:
        """The score test at one start."""
        effect = find_effect(id)
        base = self.base.model
        if effect.rest > 0:
            model = self._nearest(id, target, start)
        else:
            model = base.with_effect(id, target, _inside(base, id, target, effect.at_rest(start)))
        label = model.effects[-1].label
        shapes = [n for n in model.effects[-1].parameters if f"{label}.{n}" in model.free]
        own = [f"{label}.{n}" for n in shapes if not effect.sizes or n in effect.sizes]
        names = [*self.base.parameters, *own]
        linear = (self._at_rest(model, own) if effect.rest == 0 and effect.sizes else None) or self._linearised(model, names)
        if linear is None:
            return None
        residuals, by_parameters, by_states = linear
        equations = NormalEquations.of(residuals, by_parameters, by_states, self.base.noises)
        step, pointwise = self._feasible_fit(model, names, len(names) - len(own), linear, equations)
        gain = float(pointwise.sum()) - self.base.log_likelihood
        values = dict(zip(names, step + np.array([model.values[n] for n in names]), strict=True))
        return Screened(
            effect=id,
            target=target,
            start=_clipped(model, values, start if effect.sizes else None),
            gain=gain,
            chi_square=2.0 * gain,
            information=_information(equations, len(names) - len(own)),
            own_parameters=len(shapes),
            own=tuple(n.removeprefix(f"{label}.") for n in own),
            slopes=[J[:, :, len(names) - len(own) :] for J in by_parameters],
        )

    def _feasible_fit(
        self, model: PhysicalModel, names: list[str], first: int, linear: _Linear, equations: NormalEquations
    ) -> tuple[FloatArray, FloatArray]:
        """The first-order step, the effect's own parameters (from `first` on) kept within bounds, and its pointwise likelihood.

        A friction that would have to drive explains nothing: were it given its gain, it would take the place of one that can.
        """
        residuals, by_parameters, by_states = linear
        known = [model.all_parameters[n] for n in names]
        free = list(range(len(names)))
        while True:
            known_equations = equations if len(free) == len(names) else None
            slopes = [J[:, :, free] for J in by_parameters]
            part, pointwise, _ = first_order_fit(
                self.base, residuals, slopes, by_states, known_equations, may_fall=self._may_fall
            )
            moved = {k: known[k].value + s for k, s in zip(free, part, strict=True) if k >= first}
            out = {k for k, value in moved.items() if not known[k].lower <= value <= known[k].upper}
            if not out:
                break
            free = [k for k in free if k not in out]
        step = np.zeros(len(names))
        step[free] = part
        return step, pointwise

    def _at(self, id: str, target: str, start: dict[str, float]) -> PhysicalModel:
        """The model with the effect at its start, within bounds."""
        return self.base.model.with_effect(id, target, _inside(self.base.model, id, target, start))

    def _nearest(self, id: str, target: str, start: dict[str, float]) -> PhysicalModel:
        """The model with the effect at that fraction of its start which simulates best: where it acts about as it should."""
        full = self._at(id, target, start)
        label, sizes = full.effects[-1].label, [n for n in find_effect(id).sizes if n in start]
        tried = [_inside(self.base.model, id, target, {n: f * start[n] for n in sizes}) for f in _FRACTIONS]
        models = [full.with_values({f"{label}.{n}": value for n, value in values.items()}) for values in tried]
        errors = [self.error(model) for model in models]
        return models[int(np.argmin(errors))]

    def error(self, model: PhysicalModel) -> float:
        """Sum of the outputs' log mean square simulation errors; ∞ where the model diverges."""
        try:
            simulator = Simulator(model)
        except (BadInput, NotImplementedError):
            return np.inf
        there = self.where(model)
        base, experiments = there.base, there.experiments
        initial = _beside(base.initial, simulator)
        runs = simulator.run_each(experiments, initial, simulator.p(), substeps=base.substeps)
        if not runs.bounded:
            return np.inf
        power, count = np.nansum(runs.errors**2, axis=0), np.isfinite(runs.errors).sum(axis=0)
        return float(np.sum(np.log(np.maximum(power[count > 0] / count[count > 0], 1e-300))))

    def _at_rest(self, model: PhysicalModel, own: list[str]) -> _Linear | None:
        """The linearisation where an effect without size leaves everything as it is: the base's, and its own slopes beside.

        None where it does not.
        """
        there = self.where(model)
        base, experiments = there.base, there.experiments
        try:
            simulator = Simulator(model)
        except (BadInput, NotImplementedError):
            return None
        if len(simulator.states) > len(base.initial[0]):
            return None
        runs = simulator.run_each(experiments, base.initial, simulator.p(), slopes=own, substeps=base.substeps)
        if runs.dY is None or not runs.bounded:
            return None
        moved = np.abs(np.concatenate(runs.means(runs.errors)) - np.concatenate(base.residuals))
        if np.nanmax(moved / base.rmse, initial=0.0) > _MOVED:
            return None
        each = zip(base.by_parameters, runs.means(runs.dY), strict=True)
        by_parameters = [np.concatenate(slopes, axis=2) for slopes in each]
        return base.residuals, by_parameters, base.by_states

    def _linearised(self, model: PhysicalModel, names: list[str]) -> _Linear | None:
        try:
            simulator = Simulator(model)
        except (BadInput, NotImplementedError):  # this combination of effects has no explicit equations
            return None
        states = [f"initial:{name}" for name in simulator.free_states]
        there, p = self.where(model), simulator.p()
        base, experiments = there.base, there.experiments
        initial, steps = _beside(base.initial, simulator), list(base.substeps)
        if len(simulator.states) > len(base.initial[0]):  # only new states can be faster than the base's
            wanted = simulator.substeps_along_each(experiments, _beside(there.X, simulator), p)
            steps = [max(s, -(-fast // COARSER)) for s, fast in zip(steps, wanted, strict=True)]
        if max(steps) > there.most_substeps:
            return None
        runs = simulator.run_each(experiments, initial, p, slopes=[*names, *states], substeps=steps)
        if runs.dY is None or not runs.bounded:
            return None
        q, slopes = len(names), runs.means(runs.dY)
        return runs.means(runs.errors), [J[:, :, :q] for J in slopes], [J[:, :, q:] for J in slopes]


def _beside(states: Sequence[FloatArray], simulator: Simulator) -> list[FloatArray]:
    """The base's states with an effect's own beside them, which its kernel sets first."""
    more = len(simulator.states) - states[0].shape[-1]
    return [np.concatenate([x, np.zeros((*x.shape[:-1], more))], axis=-1) for x in states] if more else list(states)


def _repeated(means: FloatArray, experiment: Experiment) -> FloatArray:
    """Block means at the samples of their blocks, zero where missing."""
    return np.pad(np.repeat(np.nan_to_num(means), experiment.block), (0, experiment.n))[: experiment.n]


def first_order_fit(
    base: Structure,
    residuals: list[FloatArray],
    by_parameters: list[FloatArray],
    by_states: list[FloatArray],
    equations: NormalEquations | None = None,
    *,
    may_fall: bool = True,
    ridge: float = RIDGE,
) -> tuple[FloatArray, FloatArray, list[FloatArray]]:
    """Linear least squares with re-estimated noise: (step of the parameters, pointwise log-likelihood after it, residuals).

    The better of two beginnings: the base's noise (its normal `equations`, where they are known), and white noise where that
    takes the errors below the base's (not tried where they cannot fall). Where neither comes near the base, and where neither
    gains anything, the noise is left as it was: no colour makes up for that, and the base's was the best. Directions with less
    than `ridge` of the largest scaled curvature are left alone.
    """

    stacked = Stacked.of(residuals, by_parameters, by_states)

    def solved(equations: NormalEquations) -> tuple[FloatArray, list[FloatArray]]:
        step, initial = equations.step(ridge=ridge)
        return step, stacked.after(step, initial)

    def judged(step: FloatArray, rest: list[FloatArray], near: Noises | None) -> _Fitted:
        colour = fit_noises(rest, drifting=base.drifting, near=near, reading=base.reading)
        return step, pointwise_log_likelihood(rest, colour), rest, colour

    step, rest = solved(stacked.normal_equations(base.noises) if equations is None else equations)
    white = tuple(None if noise is None else replace(noise, a=np.zeros(0)) for noise in base.noises)
    step_in_white, rest_in_white = solved(stacked.normal_equations(white)) if may_fall else (step, rest)
    fallen = may_fall and _error_ratio(rest_in_white, base.residuals) < _FALLEN
    if not fallen:
        pointwise = pointwise_log_likelihood(rest, base.noises)
        gained = pointwise.sum() - base.log_likelihood
        if gained < -_HOPELESS or 0.0 <= gained < _NOTHING:
            return step, pointwise, rest
    best = judged(step, rest, base.noises)
    if fallen:
        best = max(best, judged(step_in_white, rest_in_white, None), key=lambda found: found[1].sum())
    if abs(best[1].sum() - base.log_likelihood) > _WORTH_A_PASS:
        best = max(best, judged(*solved(stacked.normal_equations(best[3])), best[3]), key=lambda found: found[1].sum())
    return best[:3]


def _may_fall(base: Structure) -> bool:
    """Whether the error of an output stands above its innovations, which nothing mends."""
    known = [o for o, noise in enumerate(base.noises) if noise is not None]
    errors = [r[:, known] for r in base.residuals]
    noises = [noise for noise in base.noises if noise is not None]
    innovations = [np.stack([n.innovations(v) for n, v in zip(noises, r.T, strict=True)], axis=1) for r in errors]
    return _error_ratio(innovations, errors) < _FALLEN


def _error_ratio(after: list[FloatArray], before: list[FloatArray]) -> float:
    """The smallest, over the outputs, of the ratios of the mean square errors' roots."""
    power = [sum(np.nansum(r**2, axis=0) for r in rest) for rest in (after, before)]
    return float(np.sqrt(np.nanmin(power[0] / np.where(power[1] > 0, power[1], np.nan))))


def _information(equations: NormalEquations, leading: int) -> float:
    """Information on parameter `leading` after those before it are free; 0 where there is none."""
    H = equations.information()
    if leading == len(H):
        return 0.0
    absorbed = solve_scaled(H[:leading, :leading], H[:leading, leading : leading + 1], RIDGE)
    return float(H[leading, leading] - H[leading, :leading] @ absorbed[:, 0])


def _inside(model: PhysicalModel, id: str, target: str, values: dict[str, float]) -> dict[str, float]:
    """The values moved to within their bounds."""
    declared = {p.name: p for p in find_effect(id).parameters(model.site(target, find_effect(id)))}
    return {n: float(np.clip(v, declared[n].lower, declared[n].upper)) for n, v in values.items() if n in declared}


def _clipped(model: PhysicalModel, values: dict[str, float], start: dict[str, float] | None) -> PhysicalModel:
    """The model at `values`, each within its bounds.

    None is moved beyond a factor of three from a base value, nor of five from the start of an effect without a zero.

    A size that the first-order step put at or below nothing begins at a hundredth of its start.
    """
    known = model.all_parameters
    label = model.effects[-1].label
    found = {}
    for name, value in values.items():
        p = known[name]
        if name.startswith(f"{label}."):
            if start is None and p.value:
                low, high = sorted((p.value / 5.0, p.value * 5.0))
                value = float(np.clip(value, low, high))
            value = float(np.clip(value, p.lower, p.upper))
            short = name.removeprefix(f"{label}.")
            if start is not None and value == p.lower and p.lower == 0.0:
                value = 0.01 * start[short]
        else:
            low, high = sorted((p.value / 3.0, p.value * 3.0))
            value = float(np.clip(value, max(low, p.lower), min(high, p.upper))) if p.value else value
        found[name] = value
    return model.with_values(found)
