"""Where the machine was and what its balances lacked, as the measurements show them; and effects regressed on that.

A score test linearises along the model's own simulation. Where that has gone astray (an arm without its weight, an axis that a
cog holds) no derivative there points to the effect. The Kalman filter stays with the machine: along its states, the term
of an effect that is missing resembles the missing term of its balance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.policy.trials import TRACK_ROWS
from residuum.identification.discrepancy.structures import Structure
from residuum.identification.errors import BadInput
from residuum.identification.physics import Experiment, PhysicalModel, Simulator
from residuum.identification.physics.effects.base import Parameter
from residuum.identification.physics.model import find_effect, place_of, term_name
from residuum.identification.physics.simulate.experiment import Spare
from residuum.identification.physics.simulate.kalman import Filter, first_noise

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Track:
    """All experiments, one after the other: `experiment` (inputs and outputs), states X (n, states), what each balance lacked."""

    experiment: Experiment
    X: FloatArray
    missing: Mapping[str, FloatArray]


def track(model: PhysicalModel, base: Structure, experiments: Sequence[Experiment], simulated: Sequence[FloatArray]) -> Track:
    """The model's smoothed states in every experiment; those `simulated`, and nothing missing, where the filter diverges."""
    kalman = Filter(model, first_noise(model, list(experiments)))
    states, lacks = [], []
    for e, x, steps, X in zip(experiments, base.initial, base.substeps, simulated, strict=True):
        found = kalman.run(e, x, substeps=None if model is not base.model else steps)
        missing = {balance: found.missing[balance].value for balance in kalman.balances}
        follows = bool(np.all(np.isfinite(found.X)) and all(np.all(np.isfinite(w)) for w in missing.values()))
        states.append(found.X if follows else X)
        lacks.append({b: missing[b] if follows and b in missing else np.zeros(e.n) for b in model.balances})
    return joined(experiments, states, lacks)


def joined(experiments: Sequence[Experiment], states: Sequence[FloatArray], lacks: Sequence[Mapping[str, FloatArray]]) -> Track:
    """The track of all experiments, from the states in each and what each balance lacked there."""
    U, Y = np.concatenate([e.U for e in experiments]), np.concatenate([e.Y for e in experiments])
    whole = replace(experiments[0], U=U, Y=Y, known={}, spare=_joined_spare(experiments))
    return Track(whole, np.concatenate(states), {b: np.concatenate([w[b] for w in lacks]) for b in lacks[0]})


def _joined_spare(experiments: Sequence[Experiment]) -> dict[str, Spare]:
    """The columns that every experiment has to spare, one after the other."""
    first, *others = experiments
    names = [n for n, s in first.spare.items() if all(n in e.spare and e.spare[n].unit == s.unit for e in others)]
    return {n: replace(first.spare[n], values=np.concatenate([e.spare[n].values for e in experiments])) for n in names}


def regressed(
    model: PhysicalModel, id: str, target: str, start: Mapping[str, float], along: Track
) -> tuple[float, PhysicalModel] | None:
    """The effect with the sizes that what its balance lacked asks for: (share of that which it explains, model).

    Least squares of the missing term on the effect's term, each size by itself, beside the balance's own terms, whose
    parameters may be off. None for an effect with states of its own, without sizes or with none inside its bounds.
    """
    effect = find_effect(id)
    if effect.place != "balance" or not effect.sizes or effect.states(model.site(target, effect)):
        return None
    every = slice(None, None, max(1, along.experiment.n // TRACK_ROWS))
    e = replace(along.experiment, U=along.experiment.U[every], Y=along.experiment.Y[every], spare={})
    X, w = along.X[every], along.missing[place_of(target)][every]
    own = own_terms(model, place_of(target), e, X)
    rest = _rest(own, w)
    power = float(rest @ rest)
    sizes = {n: start[n] for n in effect.sizes if start.get(n)}
    columns = {n: c for n in sizes if (c := _column(model, id, target, start, n, e, X)) is not None and np.any(c)}
    columns = {n: _rest(own, c) for n, c in columns.items()}
    found = _inside_bounds(columns, rest, sizes, {p.name: p for p in effect.parameters(model.site(target, effect))})
    if found is None or not power > 0.0:
        return None
    values, left = found
    return 1.0 - float(left @ left) / power, model.with_effect(id, target, dict(start) | dict.fromkeys(sizes, 0.0) | values)


def _inside_bounds(
    columns: Mapping[str, FloatArray], rest: FloatArray, sizes: Mapping[str, float], known: Mapping[str, Parameter]
) -> tuple[dict[str, float], FloatArray] | None:
    """Values whose columns come nearest to `rest`, without those that would lie outside their bounds, and what is left of it."""
    while columns:
        C = np.column_stack(list(columns.values()))
        factors = np.linalg.lstsq(C, rest, rcond=None)[0]
        values = {n: float(f * sizes[n]) for n, f in zip(columns, factors, strict=True)}
        outside = [n for n, value in values.items() if not known[n].lower < value < known[n].upper]
        if not outside:
            return values, rest - C @ factors
        columns = {n: c for n, c in columns.items() if n not in outside}
    return None


def own_terms(model: PhysicalModel, target: str, e: Experiment, X: FloatArray) -> FloatArray:
    """Orthonormal basis of the balance's terms along the states."""
    look = Simulator(model).look(e, X)
    terms = [z for name, z in look.items() if name.startswith(f"{target}.") and name != f"{target}.missing" and np.any(z)]
    if not terms or not np.all(np.isfinite(terms)):
        return np.zeros((len(X), 0))
    u, s, _ = np.linalg.svd(np.column_stack([z / np.linalg.norm(z) for z in terms]), full_matrices=False)
    return np.asarray(u[:, s > 1e-9 * s[0]])


def _column(
    model: PhysicalModel, id: str, target: str, start: Mapping[str, float], size: str, e: Experiment, X: FloatArray
) -> FloatArray | None:
    """The effect's term with one of its sizes alone."""
    alone = {n: 0.0 if n in find_effect(id).sizes and n != size else value for n, value in start.items()}
    try:
        used = model.with_effect(id, target, alone)
        term = Simulator(used).look(e, X)[f"{place_of(target)}.{term_name(used.effects[-1])}"]
    except (BadInput, NotImplementedError):
        return None
    return term if np.all(np.isfinite(term)) else None


def _rest(basis: FloatArray, v: FloatArray) -> FloatArray:
    return np.asarray(v - basis @ (basis.T @ v))
