"""The free term: what any smooth function of one signal, in one balance, would take away on unseen blocks.

It stands for the effects that the catalogue does not have. A balance receives Σ c_j·φ_j(axis) with hat functions φ_j on a
signal of the model (velocity, position, current, temperature, level, time); its effect on the outputs is propagated through the
model linearised along its simulation, and c follows from the same equations as the parameters. A name stands only where no such
function does plainly more.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.physics import Experiment, PhysicalModel, Simulator, balance_variables
from residuum.identification.side_by_side import side_by_side
from residuum.identification.unseen_blocks.comparing import evidence
from residuum.identification.unseen_blocks.judged import Equations, Judged, equations, summed
from residuum.identification.unseen_blocks.linear_response import LinearResponse, linear_response
from residuum.identification.unseen_blocks.looks import Court
from residuum.identification.unseen_blocks.policy import KNOTS_BY_AXIS


@dataclass(frozen=True, eq=False)
class BlockTerm:
    """One free term: where it acts, the signal it is a function of, its curve (`value` in `unit` over `at`), and its errors.

    `power` (blocks, measured outputs) in the court's scale, on blocks that it has not seen; it has so many `parameters` more,
    and `evidence` are its log odds against the structure alone.
    """

    balance: str
    axis: str
    unit: str
    at: FloatArray
    value: FloatArray
    power: FloatArray
    parameters: float
    cost: float
    evidence: float


def free_terms(one: Judged, court: Court) -> list[BlockTerm]:
    """Every free term beside a structure, the best first; none where the model diverges or has nowhere to put one."""
    last, found = court.last, court.begun(one.structure)
    at = None if found is None else equations(found, last, court.scale)
    if found is None or at is None:
        return []
    each = zip(last.parts, found.initial, found.substeps, strict=True)
    responses = [linear_response(found.model, e, x, s) for e, x, s in each]
    if not all(np.all(np.isfinite(r.F)) and np.all(np.isfinite(r.C)) for r in responses):
        return []
    kernel = at

    def judged(term: tuple[str, str, FloatArray, list[FloatArray]]) -> BlockTerm:
        return _judged(term, one, court, kernel, responses)

    terms = list(_terms(found.model, last.parts, responses))
    return sorted(side_by_side(judged, terms), key=lambda term: term.cost)


def _judged(
    term: tuple[str, str, FloatArray, list[FloatArray]],
    one: Judged,
    court: Court,
    at: Equations,
    responses: Sequence[LinearResponse],
) -> BlockTerm:
    balance, axis, knots, functions = term
    scale, last = court.scale, court.last
    measured = scale.weights > 0.0
    columns = np.concatenate([r.to(balance, h) for r, h in zip(responses, functions, strict=True)])
    columns = scale.whitened(columns * scale.weights[:, None], at.starts)[:, measured]
    columns[~at.known] = 0.0
    extra, clip = at.beside_states(columns), scale.clip[measured]
    each = (at.unseen(last.block, court.data.fold, more) for more in (None, extra))
    before, after = (summed(np.where(at.known, np.clip(e, -clip, clip), 0.0) ** 2, last, court.data.blocks) for e in each)
    power = one.power * after / np.maximum(before, 1e-300)  # both by the equations alone, which know no fold's own simulation
    parameters = one.parameters + len(knots)
    unit = one.model.balances[balance].unit
    found = BlockTerm(balance, axis, unit, knots, at.step(extra), power, parameters, scale.cost(power, parameters), 0.0)
    return replace(found, evidence=evidence(found, one, scale))


def _terms(
    model: PhysicalModel, parts: Sequence[Experiment], responses: Sequence[LinearResponse]
) -> Iterator[tuple[str, str, FloatArray, list[FloatArray]]]:
    """Balance, axis, knots and hat functions (n, knots) of each part."""
    simulator, begin = Simulator(model), min(part.t0 for part in parts)
    times = [part.t0 - begin + part.sample_time * np.arange(part.n) for part in parts]
    for name, balance in model.balances.items():
        signals = [balance_variables(simulator, balance, e, r.X) for e, r in zip(parts, responses, strict=True)]
        axes = {axis: [s[axis] for s in signals] for axis in KNOTS_BY_AXIS if axis in signals[0]} | {"time": times}
        for axis, values in axes.items():
            joined = np.concatenate(values)
            if np.all(np.isfinite(joined)) and np.ptp(joined) > 0:
                knots: FloatArray = np.linspace(joined.min(), joined.max(), KNOTS_BY_AXIS[axis])
                yield name, axis, knots, [hats(np.asarray(v), knots) for v in values]


def hats(x: FloatArray, knots: npt.NDArray[np.floating[Any]]) -> FloatArray:
    """Piecewise linear functions, one at each knot, shape (n, knots); they sum to one."""
    return np.maximum(0.0, 1.0 - np.abs(x[:, None] - knots) / (knots[1] - knots[0]))
