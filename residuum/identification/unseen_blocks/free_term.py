"""The free term: what any smooth function of one signal, in one balance, would take away on unseen
blocks.

It stands for the effects that the catalogue does not have. A balance receives Σ c_j·φ_j(axis) with
hat functions φ_j on a signal of the model (velocity, position, current, temperature, level, time);
its effect on the outputs is propagated through the model linearised along its simulation, and c
follows from the same equations as the parameters. A name stands only where no such function does
plainly more.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
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
from residuum.identification.unseen_blocks.cross_validation import (
    CrossValidation,
    Equations,
    ValidatedFit,
    equations,
    summed,
)
from residuum.identification.unseen_blocks.policy import FORMULA_TERMS, KNOTS_BY_AXIS
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
    with simulator.settled(p):
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
    # at every sample: C, D by the observation there, F, G by the sensitivities over the step that
    # follows, begun at ∂x/∂x = 1, ∂x/∂w = 0
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

    `power` (blocks, measured outputs) in the scale of the validation, on blocks that it has not
    seen; it has so many `parameters` more, and `evidence` are its log odds against the structure
    alone.
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


def free_terms(parent: ValidatedFit, validation: CrossValidation) -> list[BlockTerm]:
    """Every free term beside a structure, the best first; none where the model diverges or has
    nowhere to put one.
    """
    last, fit = validation.last, validation.begun(parent.structure)
    at = None if fit is None else equations(fit, last, validation.scale)
    if fit is None or at is None:
        return []
    runs = zip(last.parts, fit.initial, fit.substeps, strict=True)
    responses = [linear_response(fit.model, e, x, s) for e, x, s in runs]
    if not all(np.all(np.isfinite(r.F)) and np.all(np.isfinite(r.C)) for r in responses):
        return []
    kernel = at

    def validated(term: tuple[str, str, FloatArray, list[FloatArray]]) -> BlockTerm:
        return _validated(term, parent, validation, kernel, responses)

    terms = list(_terms(fit.model, last.parts, responses))
    return sorted(side_by_side(validated, terms), key=lambda term: term.cost)


def _validated(
    term: tuple[str, str, FloatArray, list[FloatArray]],
    parent: ValidatedFit,
    validation: CrossValidation,
    at: Equations,
    responses: Sequence[LinearResponse],
) -> BlockTerm:
    balance, axis, knots, functions = term
    scale, last = validation.scale, validation.last
    measured = scale.weights > 0.0
    columns = np.concatenate([r.to(balance, h) for r, h in zip(responses, functions, strict=True)])
    columns = scale.whitened(columns * scale.weights[:, None], at.starts)[:, measured]
    columns[~at.known] = 0.0
    extra, clip = at.beside_states(columns), scale.clip[measured]
    errors = (at.unseen(last.block, validation.data.fold, more) for more in (None, extra))
    before, after = (
        summed(np.where(at.known, np.clip(e, -clip, clip), 0.0) ** 2, last, validation.data.blocks)
        for e in errors
    )
    # The parent's power was found by simulated steps, that of the term is known by equations alone:
    # their ratio with and without the term carries what it takes away over to the parent's.
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
    for balance in model.balances:
        for axis, values in _axes_of(model, balance, parts, responses).items():
            joined = np.concatenate(values)
            if np.all(np.isfinite(joined)) and np.ptp(joined) > 0:
                knots: FloatArray = np.linspace(joined.min(), joined.max(), KNOTS_BY_AXIS[axis])
                yield balance, axis, knots, [hats(np.asarray(part), knots) for part in values]


def _axes_of(
    model: PhysicalModel,
    name: str,
    parts: Sequence[Experiment],
    responses: Sequence[LinearResponse],
) -> dict[str, list[FloatArray]]:
    """The signals that a term in a balance may be a function of, along the simulation of each part;
    time from the begin of the first part on.
    """
    simulator, begin = Simulator(model), min(part.t0 for part in parts)
    signals = [
        balance_variables(simulator, model.balances[name], part, response.X)
        for part, response in zip(parts, responses, strict=True)
    ]
    axes = {axis: [s[axis] for s in signals] for axis in KNOTS_BY_AXIS if axis in signals[0]}
    axes["time"] = [
        np.asarray(part.t0 - begin + part.sample_time * np.arange(part.n), dtype=np.float64)
        for part in parts
    ]
    return axes


def hats(x: FloatArray, knots: npt.NDArray[np.floating[Any]]) -> FloatArray:
    """Piecewise linear functions, one at each knot, shape (n, knots); they sum to one."""
    return np.maximum(0.0, 1.0 - np.abs(x[:, None] - knots) / (knots[1] - knots[0]))


# A formula for the free term: the few simple functions of its axis that make up its curve.

LIBRARY: Mapping[str, Callable[[FloatArray], FloatArray]] = {
    "1": np.ones_like,
    "{z}": lambda z: z,
    "{z}²": np.square,
    "{z}³": lambda z: z**3,
    "sign({z})": np.sign,
    "|{z}|·{z}": lambda z: np.abs(z) * z,
    "|{z}|": np.abs,
    "sin(2π·{z})": lambda z: np.sin(2 * np.pi * z),
    "cos(2π·{z})": lambda z: np.cos(2 * np.pi * z),
    "exp(−({z}/0.15)²)·sign({z})": lambda z: np.exp(-((z / 0.15) ** 2)) * np.sign(z),
}
"""Functions of z = axis / largest magnitude on the axis."""


@dataclass(frozen=True)
class Suggestion:
    """A sum of library functions: `formula` (coefficients in the term's unit), `largest` = the axis
    value that z = 1 stands for, and the `share` of the curve's variance that it follows.
    """

    formula: str
    largest: float
    share: float


def nearest_formula(at: FloatArray, value: FloatArray) -> Suggestion | None:
    """The sparse regression of a curve, `value` (knots,) over `at` (knots,); None for one without
    any spread.

    Every sum of up to three functions is tried (the library is small); Schwarz's criterion on the
    knots chooses. It is a description, not a law: a function of the wrong axis is described as
    willingly.
    """
    largest = float(np.max(np.abs(at)))
    spread = float(np.sum((value - value.mean()) ** 2))
    if not largest > 0 or not spread > 0:
        return None
    z, n = at / largest, at.size
    columns = {name: function(z) for name, function in LIBRARY.items()}
    best: tuple[float, tuple[str, ...], FloatArray, float] | None = None
    for count in range(1, FORMULA_TERMS + 1):
        for names in combinations(columns, count):
            design: FloatArray = np.column_stack([columns[name] for name in names])
            coefficients: FloatArray = np.asarray(
                np.linalg.lstsq(design, value, rcond=None)[0], dtype=np.float64
            )
            squares = float(np.sum((value - design @ coefficients) ** 2))
            criterion = float(n * np.log(squares / spread + 1e-6) + count * np.log(n))
            if best is None or criterion < best[0]:
                best = criterion, names, coefficients, squares
    assert best is not None  # one function at least was tried
    _, chosen, weights, left = best
    terms = [f"{c:+.3g}·{name.format(z='z')}" for c, name in zip(weights, chosen, strict=True)]
    return Suggestion(" ".join(terms), largest, max(0.0, 1.0 - left / spread))
