"""Screening: what would each effect explain, to first order, after the free parameters have explained what they can?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.fitting.start_values import clipped_step, inside_bounds
from residuum.identification.discrepancy.fitting.structures import Structure, times_its_innovations
from residuum.identification.discrepancy.fitting.whitened_least_squares import NormalEquations
from residuum.identification.discrepancy.policy.likelihood import FAR_BEHIND
from residuum.identification.discrepancy.policy.trials import FRACTIONS_OF_A_START, MOST_STARTS
from residuum.identification.discrepancy.screening.first_order import base_may_fall, first_order_fit, information_on
from residuum.identification.discrepancy.screening.in_blocks import Sampled, at_every_sample, in_blocks
from residuum.identification.discrepancy.screening.linearisation import Linear, at_rest, linearised, simulation_error
from residuum.identification.discrepancy.screening.track import track
from residuum.identification.physics import Experiment, Key, PhysicalModel, conditions_at
from residuum.identification.physics.effects.base import Conditions, Effect
from residuum.identification.physics.model import find_effect
from residuum.identification.residual_analysis.policy.noise import NOISE_ALONE
from residuum.identification.side_by_side import side_by_side
from residuum.identification.unseen_blocks.following import regressed

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Screened:
    """One candidate (effect, target) at one first shape.

    Attributes
    ----------
    start : PhysicalModel
        With the effect at the values the first-order step suggests (within bounds).
    gain : float
        First-order log-likelihood gain over the base, noise colour re-estimated.
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
    information: float
    own_parameters: int
    own: tuple[str, ...]
    slopes: list[FloatArray]

    @property
    def key(self) -> Key:
        """(effect id, target)."""
        return Key(self.effect, self.target)


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
        self._may_fall, self._noise_alone = base_may_fall(base), times_its_innovations(base) < NOISE_ALONE
        self._conditions: dict[tuple[str, str], Conditions] = {}
        self._tested: dict[Key, list[Screened]] = {}

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
        tried = [regressed(Key(id, target), start, self.track) for start in self.starts(id, target)]
        return max((found for found in tried if found is not None), key=lambda found: found[0], default=None)

    def best(self, id: str, target: str) -> Screened | None:
        """The candidate at the start that explains most; None when it diverges at every start."""
        return max(self.tests(id, target), key=lambda s: s.gain, default=None)

    def tests(self, id: str, target: str) -> list[Screened]:
        """The candidate at every start where it does not diverge; each is tested once."""
        key = Key(id, target)
        self.test_all([key])
        return self._tested[key]

    def test_all(self, pairs: Sequence[Key]) -> None:
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

    def _in_turn(self, pair: Key, starts: Sequence[dict[str, float]]) -> list[Screened]:
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

    def promising(self, id: str, target: str, most: int = MOST_STARTS) -> list[Screened]:
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
            model = base.with_effect(id, target, inside_bounds(base, id, target, effect.at_rest(start)))
        label = model.effects[-1].label
        shapes = [n for n in model.effects[-1].parameters if f"{label}.{n}" in model.free]
        own = [f"{label}.{n}" for n in shapes if not effect.sizes or n in effect.sizes]
        names = [*self.base.parameters, *own]
        there = self.where(model)
        linear = (at_rest(model, own, there) if effect.rest == 0 and effect.sizes else None) or linearised(model, names, there)
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
            start=clipped_step(model, values, start if effect.sizes else None),
            gain=gain,
            information=information_on(equations, len(names) - len(own)),
            own_parameters=len(shapes),
            own=tuple(n.removeprefix(f"{label}.") for n in own),
            slopes=[J[:, :, len(names) - len(own) :] for J in by_parameters],
        )

    def _feasible_fit(
        self, model: PhysicalModel, names: list[str], first: int, linear: Linear, equations: NormalEquations
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
        return self.base.model.with_effect(id, target, inside_bounds(self.base.model, id, target, start))

    def _nearest(self, id: str, target: str, start: dict[str, float]) -> PhysicalModel:
        """The model with the effect at that fraction of its start which simulates best: where it acts about as it should."""
        full = self._at(id, target, start)
        label, sizes = full.effects[-1].label, [n for n in find_effect(id).sizes if n in start]
        tried = [inside_bounds(self.base.model, id, target, {n: f * start[n] for n in sizes}) for f in FRACTIONS_OF_A_START]
        models = [full.with_values({f"{label}.{n}": value for n, value in values.items()}) for values in tried]
        errors = [self.error(model) for model in models]
        return models[int(np.argmin(errors))]

    def error(self, model: PhysicalModel) -> float:
        """Sum of the outputs' log mean square simulation errors; ∞ where the model diverges."""
        return simulation_error(model, self.where(model))


def _repeated(means: FloatArray, experiment: Experiment) -> FloatArray:
    """Block means at the samples of their blocks, zero where missing."""
    return np.pad(np.repeat(np.nan_to_num(means), experiment.block), (0, experiment.n))[: experiment.n]
