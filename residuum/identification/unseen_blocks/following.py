"""Where the machine was and what its balances lacked, as the measurements show them; and effects
regressed on that.

A simulation that has gone astray (an arm without its weight, an axis that a cog holds) does not
point to the effect. The Kalman filter stays with the machine: along its states, the term of an
effect that is missing resembles the missing term of its balance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput
from residuum.identification.physics import Experiment, Key, PhysicalModel, Simulator
from residuum.identification.physics.effects.base import Parameter
from residuum.identification.physics.model import find_effect, place_of, term_name
from residuum.identification.physics.simulate.experiment import Spare
from residuum.identification.physics.simulate.kalman import Filter, Smoothed, first_noise
from residuum.identification.unseen_blocks.policy import ROWS, WALKS

if TYPE_CHECKING:
    from residuum.identification.unseen_blocks.data import Data, Horizon


@dataclass(frozen=True, eq=False)
class Track:
    """All experiments, one after the other: `experiment` (inputs and outputs), states X (n,
    states), what each balance lacked.

    `errors` (n, outputs) are those of the model's simulation, 0 where nothing is known of them;
    `longest` are the rows of the longest experiment.
    """

    model: PhysicalModel
    experiment: Experiment
    X: FloatArray
    missing: Mapping[str, FloatArray]
    errors: FloatArray
    longest: slice

    @property
    def thinned(self) -> Track:
        """At most about `ROWS` of its rows."""
        every = slice(None, None, max(1, self.experiment.n // ROWS))
        e = replace(
            self.experiment, U=self.experiment.U[every], Y=self.experiment.Y[every], spare={}
        )
        missing = {b: w[every] for b, w in self.missing.items()}
        return replace(
            self, experiment=e, X=self.X[every], missing=missing, errors=self.errors[every]
        )


def followed(
    model: PhysicalModel,
    data: Data,
    errors: FloatArray | None = None,
    horizon: Horizon | None = None,
) -> Track | None:
    """The model's smoothed states in every experiment, and what its balances lacked; where no
    filter follows them, its simulation, of whose balances nothing is known to lack. None where that
    diverges, too.

    `errors` (rows, outputs) are those of its simulation on a horizon, where they are known.
    """
    experiments = data.experiments
    known = _filtered(model, experiments) or _simulated(model, experiments)
    if known is None:
        return None
    states, lacks = known
    along = joined(model, experiments, states, lacks)
    if errors is not None and horizon is not None:
        along.errors[data.rows(horizon)] = np.nan_to_num(errors)
    return along


_Known = tuple[Sequence[FloatArray], Sequence[Mapping[str, FloatArray]]]
"""The states in each experiment, and what each balance lacked there."""


def _filtered(model: PhysicalModel, experiments: Sequence[Experiment]) -> _Known | None:
    """By a filter whose unknown terms walk as far as it is not lost; None where each is."""
    simulator, noise = Simulator(model), first_noise(model, experiments)
    for share in WALKS:
        kalman = Filter(model, noise.walking(share))
        smoothed = [kalman.run(e, simulator.x0(e.known)) for e in experiments]
        if all(map(_is_finite, smoothed)):
            return [s.X for s in smoothed], [_lacks(model, s) for s in smoothed]
    return None


def _lacks(model: PhysicalModel, smoothed: Smoothed) -> dict[str, FloatArray]:
    """What each balance lacked; of one whose missing term was not estimated nothing is known."""
    nothing = np.zeros(len(smoothed.X))
    known = {b: term.value for b, term in smoothed.missing.items()}
    return {b: known.get(b, nothing) for b in model.balances}


def _simulated(model: PhysicalModel, experiments: Sequence[Experiment]) -> _Known | None:
    """By simulation, which knows of nothing that a balance lacks; None where it diverges."""
    simulator = Simulator(model)
    X0, p = [simulator.measured_start(e) for e in experiments], simulator.p()
    runs = simulator.run_each(
        experiments, X0, p, substeps=simulator.modal_substeps(experiments, X0, p)
    )
    lacks = [{b: np.zeros(e.n) for b in model.balances} for e in experiments]
    return ([run.X for run in runs], lacks) if runs.bounded else None


def _is_finite(smoothed: Smoothed) -> bool:
    missing = [term.value for term in smoothed.missing.values()]
    return all(np.all(np.isfinite(values)) for values in (smoothed.X, *missing))


def joined(
    model: PhysicalModel,
    experiments: Sequence[Experiment],
    states: Sequence[FloatArray],
    lacks: Sequence[Mapping[str, FloatArray]],
) -> Track:
    """The track of all experiments, from the states in each and what each balance lacked there; no
    errors are known.
    """
    lengths = [e.n for e in experiments]
    longest = int(np.argmax(lengths))
    begin, whole = sum(lengths[:longest]), _joined(experiments)
    missing = {b: np.concatenate([w[b] for w in lacks]) for b in lacks[0]}
    rows = slice(begin, begin + lengths[longest])
    return Track(model, whole, np.concatenate(states), missing, np.zeros(whole.Y.shape), rows)


def _joined(experiments: Sequence[Experiment]) -> Experiment:
    first, *later = experiments
    names = [
        n
        for n, s in first.spare.items()
        if all(n in e.spare and e.spare[n].unit == s.unit for e in later)
    ]
    spare: dict[str, Spare] = {
        n: replace(first.spare[n], values=np.concatenate([e.spare[n].values for e in experiments]))
        for n in names
    }
    U, Y = np.concatenate([e.U for e in experiments]), np.concatenate([e.Y for e in experiments])
    return replace(first, U=U, Y=Y, known={}, spare=spare)


def regressed(
    key: Key, start: Mapping[str, float], along: Track
) -> tuple[float, PhysicalModel] | None:
    """The effect in the sizes that what its balance lacked asks for: (share of it that it explains,
    model).

    Least squares of the missing term on the effect's term, each size by itself, beside the
    balance's own terms, whose parameters may be off. None for an effect with states of its own,
    without sizes or with none inside its bounds.
    """
    effect, model = find_effect(key.effect), along.model
    if effect.place != "balance" or not effect.sizes:
        return None
    site = model.site(key.target, effect)
    if effect.states(site):  # its term depends on where its own states are, which no track knows
        return None
    few, place = along.thinned, place_of(key.target)
    own = own_terms(model, place, few)
    lack = beside(own, few.missing[place])
    sizes = {name: start[name] for name in effect.sizes if start.get(name)}
    columns = {name: beside(own, term) for name, term in _terms(key, start, few).items()}
    known = {p.name: p for p in effect.parameters(site)}
    power = float(lack @ lack)
    solution = _inside_bounds(columns, lack, sizes, known) if power > 0.0 else None
    if solution is None:
        return None
    values, left = solution
    # sizes that would lie outside of their bounds are none
    regressed_values = dict(start) | dict.fromkeys(sizes, 0.0) | values
    return 1.0 - float(left @ left) / power, model.with_effect(*key, regressed_values)


def _inside_bounds(
    columns: Mapping[str, FloatArray],
    lack: FloatArray,
    sizes: Mapping[str, float],
    known: Mapping[str, Parameter],
) -> tuple[dict[str, float], FloatArray] | None:
    """Values whose columns come nearest to `lack`, without those that would lie outside their
    bounds, and what is left of it.
    """
    while columns:
        C = np.column_stack(list(columns.values()))
        factors = np.linalg.lstsq(C, lack, rcond=None)[0]
        values = {n: float(f * sizes[n]) for n, f in zip(columns, factors, strict=True)}
        outside = [n for n, value in values.items() if not known[n].lower < value < known[n].upper]
        if not outside:
            return values, lack - C @ factors
        columns = {n: c for n, c in columns.items() if n not in outside}
    return None


def own_terms(model: PhysicalModel, balance: str, along: Track) -> FloatArray:
    """Orthonormal basis of the balance's terms along the states."""
    look = Simulator(model).look(along.experiment, along.X)
    terms = [
        z
        for name, z in look.items()
        if name.startswith(f"{balance}.") and name != f"{balance}.missing" and np.any(z)
    ]
    if not terms or not np.all(np.isfinite(terms)):
        return np.zeros((len(along.X), 0))
    # scaled by the largest first: the squares of what is next to nothing would be nothing
    scaled = [z / np.abs(z).max() for z in terms]
    columns = np.column_stack([z / np.linalg.norm(z) for z in scaled])
    u, s, _ = np.linalg.svd(columns, full_matrices=False)
    # terms that depend on each other (a viscous loss and a gain of the same speed) are one
    # direction
    return np.asarray(u[:, s > 1e-9 * s[0]])


def beside(basis: FloatArray, v: FloatArray) -> FloatArray:
    """What is left of v beside an orthonormal basis."""
    return np.asarray(v - basis @ (basis.T @ v))


def _terms(key: Key, start: Mapping[str, float], along: Track) -> dict[str, FloatArray]:
    """The effect's term with each of its sizes alone, where that is known and not zero."""
    terms = {}
    for name in find_effect(key.effect).sizes:
        term = _term(key, start, name, along) if start.get(name) else None
        if term is not None and np.any(term):
            terms[name] = term
    return terms


def _term(key: Key, start: Mapping[str, float], size: str, along: Track) -> FloatArray | None:
    """The effect's term with one of its sizes alone."""
    alone = {
        n: 0.0 if n in find_effect(key.effect).sizes and n != size else value
        for n, value in start.items()
    }
    try:
        used = along.model.with_effect(*key, alone)
        term = Simulator(used).look(along.experiment, along.X)[
            f"{place_of(key.target)}.{term_name(used.effects[-1])}"
        ]
    except BadInput:
        return None
    return term if np.all(np.isfinite(term)) else None
