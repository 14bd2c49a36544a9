"""The free term: what any smooth function of one signal, in one balance, would take away on unseen
blocks.

It stands for the effects that the catalogue does not have. A balance receives Σ c_j·φ_j(axis) with
hat functions φ_j on a signal of the model (velocity, position, current, temperature, level, time);
its effect on the outputs is propagated through the model linearised along its simulation, and c
follows from the same equations as the parameters. A name stands only where no such function does
plainly more.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.physics import Experiment, PhysicalModel, Simulator, balance_variables
from residuum.identification.physics.simulate.integration import (
    integrate,
    new_memory,
    observe,
    observe_slopes,
)
from residuum.identification.side_by_side import side_by_side
from residuum.identification.unseen_blocks.comparing import evidence
from residuum.identification.unseen_blocks.judged import Equations, Judged, equations, summed
from residuum.identification.unseen_blocks.looks import Court
from residuum.identification.unseen_blocks.policy import KNOTS_BY_AXIS
from residuum.kept_loops import njit

# Response of a model, linearised along a trajectory, to a term that varies in time in one of its
# balances.


@dataclass(frozen=True, eq=False)
class LinearResponse:
    """z(k+1) = F(k) z(k) + G(k) w(k), δy(k) = C(k) z(k) + D(k) w(k), one column a balance. Over a
    sample, w counts with the mean of its two ends.

    `X` (n, states) is the trajectory; F (n, states, states + balances) holds F and G, C (n,
    outputs, states + balances) C and D.
    """

    balances: tuple[str, ...]
    X: FloatArray
    F: FloatArray
    C: FloatArray

    def to(self, balance: str, terms: FloatArray) -> FloatArray:
        """Change of the outputs for terms (n, m) in the balance's unit added to its sum, shape (n,
        outputs, m).
        """
        return np.asarray(
            _respond(self.F, self.C, self.balances.index(balance), np.ascontiguousarray(terms))
        )


def linear_response(
    model: PhysicalModel, experiment: Experiment, x0: FloatArray, substeps: int
) -> LinearResponse:
    """Linearise the model along its simulation from x0."""
    simulator = Simulator(model)
    names = [f"initial:{name}" for name in simulator.states] + [
        balance.missing for balance in model.balances.values()
    ]
    columns, p = simulator.columns(names), simulator.p()
    X = simulator.run_vectors(experiment, x0, p, substeps=substeps).X
    arguments = (experiment.U, X, p, columns, experiment.sample_time, substeps, experiment.hold)
    F, C = _transitions(simulator.kernel.system, *arguments)
    return LinearResponse(tuple(model.balances), X, F, C)


@njit(error_model="numpy")
def _transitions(q, U, X, p, columns, sample_time, substeps, hold):  # type: ignore[no-untyped-def]  # compiled
    n, nx, m = X.shape[0], X.shape[1], columns.shape[0]
    F, C = np.zeros((n, nx, m)), np.zeros((n, q.sizes[3], m))
    w, y, none, none3 = (
        new_memory(q, m),
        np.zeros(q.sizes[3]),
        np.zeros((0, 0)),
        np.zeros((0, 0, 0)),
    )
    for k in range(n):
        w.x[:] = X[k]
        observe(q, w, U, k, sample_time, hold, p, y)
        observe_slopes(q, w, p)
        for o in range(y.shape[0]):
            for j in range(m):
                C[k, o, j] = w.C[o, j] if j < nx else w.D[o, columns[j]]
        if k < n - 1:
            w.S[:] = 0.0
            for i in range(nx):
                w.S[i, i] = 1.0
            integrate(q, w, U, k, k + 1, sample_time, substeps, hold, p, columns, none, none, none3)
            F[k] = w.S
    return F, C


@njit(error_model="numpy")
def _respond(F, C, balance, terms):  # type: ignore[no-untyped-def]  # compiled
    n, nx, m = F.shape[0], F.shape[1], terms.shape[1]
    out = np.zeros((n, C.shape[1], m))
    z, following = np.zeros((nx, m)), np.zeros((nx, m))
    for k in range(n):
        for o in range(C.shape[1]):
            for c in range(m):
                out[k, o, c] = C[k, o, nx + balance] * terms[k, c]
                for i in range(nx):
                    out[k, o, c] += C[k, o, i] * z[i, c]
        for i in range(nx):
            for c in range(m):
                following[i, c] = (
                    0.5 * F[k, i, nx + balance] * (terms[k, c] + terms[min(k + 1, n - 1), c])
                )
                for j in range(nx):
                    following[i, c] += F[k, i, j] * z[j, c]
        z[:] = following
    return out


@dataclass(frozen=True, eq=False)
class BlockTerm:
    """One free term: where it acts, the signal it is a function of, its curve (`value` in `unit`
    over `at`), and its errors.

    `power` (blocks, measured outputs) in the court's scale, on blocks that it has not seen; it has
    so many `parameters` more, and `evidence` are its log odds against the structure alone.
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


def free_terms(parent: Judged, court: Court) -> list[BlockTerm]:
    """Every free term beside a structure, the best first; none where the model diverges or has
    nowhere to put one.
    """
    last, fit = court.last, court.begun(parent.structure)
    at = None if fit is None else equations(fit, last, court.scale)
    if fit is None or at is None:
        return []
    runs = zip(last.parts, fit.initial, fit.substeps, strict=True)
    responses = [linear_response(fit.model, e, x, s) for e, x, s in runs]
    if not all(np.all(np.isfinite(r.F)) and np.all(np.isfinite(r.C)) for r in responses):
        return []
    kernel = at

    def judged(term: tuple[str, str, FloatArray, list[FloatArray]]) -> BlockTerm:
        return _judged(term, parent, court, kernel, responses)

    terms = list(_terms(fit.model, last.parts, responses))
    return sorted(side_by_side(judged, terms), key=lambda term: term.cost)


def _judged(
    term: tuple[str, str, FloatArray, list[FloatArray]],
    parent: Judged,
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
    errors = (at.unseen(last.block, court.data.fold, more) for more in (None, extra))
    before, after = (
        summed(np.where(at.known, np.clip(e, -clip, clip), 0.0) ** 2, last, court.data.blocks)
        for e in errors
    )
    # both by the equations alone, which know no fold's own simulation
    power = parent.power * after / np.maximum(before, 1e-300)
    parameters = parent.parameters + len(knots)
    unit = parent.model.balances[balance].unit
    free_term = BlockTerm(
        balance,
        axis,
        unit,
        knots,
        at.step(extra),
        power,
        parameters,
        scale.cost(power, parameters),
        0.0,
    )
    return replace(free_term, evidence=evidence(free_term, parent, scale))


def _terms(
    model: PhysicalModel, parts: Sequence[Experiment], responses: Sequence[LinearResponse]
) -> Iterator[tuple[str, str, FloatArray, list[FloatArray]]]:
    """Balance, axis, knots and hat functions (n, knots) of each part."""
    simulator, begin = Simulator(model), min(part.t0 for part in parts)
    times = [part.t0 - begin + part.sample_time * np.arange(part.n) for part in parts]
    for name, balance in model.balances.items():
        signals = [
            balance_variables(simulator, balance, e, r.X)
            for e, r in zip(parts, responses, strict=True)
        ]
        axes = {
            axis: [s[axis] for s in signals] for axis in KNOTS_BY_AXIS if axis in signals[0]
        } | {"time": times}
        for axis, values in axes.items():
            joined = np.concatenate(values)
            if np.all(np.isfinite(joined)) and np.ptp(joined) > 0:
                knots: FloatArray = np.linspace(joined.min(), joined.max(), KNOTS_BY_AXIS[axis])
                yield name, axis, knots, [hats(np.asarray(v), knots) for v in values]


def hats(x: FloatArray, knots: npt.NDArray[np.floating[Any]]) -> FloatArray:
    """Piecewise linear functions, one at each knot, shape (n, knots); they sum to one."""
    return np.maximum(0.0, 1.0 - np.abs(x[:, None] - knots) / (knots[1] - knots[0]))
