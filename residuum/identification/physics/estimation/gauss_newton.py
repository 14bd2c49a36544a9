"""Least squares of a model's simulation error as one compiled pass, and what follows from it
without another simulation.

A pass simulates windows of records with forward sensitivities and adds up, for each *cell* (the
rows of one window in one block) and output, the normal equations M = Σ v vᵀ of v = w·[∂y/∂θ,
∂y/∂x₀, e]; no trajectory is kept. The first states of a window touch no other one, so they are
eliminated: with z = (I, −E), E their best answer to a change of the parameters and to the error,
the equations of a cell are zᵀMz. From these follow the next step, what it promises, and the fit
without some cells (downdating).

Weights are Huber's: an error beyond `clip` counts in proportion to its size. Errors are whitened by
an autoregression of each output where one is given; a missing sample counts nothing. A parameter's
prior is one more row (`priors`).

References
----------
P. J. Huber, *Robust Statistics*, 1981, ch. 7; R. D. Cook, S. Weisberg, *Residuals and Influence in
Regression*, 1982, ch. 2.
"""

# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator"

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np
import numpy.typing as npt

from residuum.identification.descent import ATTEMPTS, HARDER, End, descend
from residuum.identification.physics.estimation.least_squares import (
    NOTHING_ALONG,
    bounded_step,
    covariance_of,
    solved,
)
from residuum.identification.physics.estimation.priors import Priors
from residuum.identification.physics.simulate.experiment import Experiment
from residuum.identification.physics.simulate.integration import begin, integrate, new_memory
from residuum.identification.physics.simulate.simulation import Joined, Simulator
from residuum.identification.work import count_samples
from residuum.kept_loops import njit

if TYPE_CHECKING:
    from residuum.identification.physics.model import PhysicalModel

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

PROMISED = 0.3
"""Part of the fall of the cost at which a descent ends, below which a step that promises it is not
taken.
"""
AT_ONCE, OVERFLOW = 64, 1e60
"""Samples that are simulated before their products are added up (they stay in the processor's
cache), and errors of no use.
"""
SHORTENED = (0.0, 0.1, 1.0, 10.0)
"""Dampings by which a step without some cells is shortened until the others are fitted no worse."""


class _Unit(Protocol):
    """In what errors are measured: 1/σ of each output (0: it does not count), the weighted errors
    beyond which Huber's weights fall, whitening autoregressions (1, a₁, …), one an output, and the
    variance of a weighted error that is noise, beside which priors count (0: they do not).
    """

    @property
    def weights(self) -> Array: ...
    @property
    def clip(self) -> Array: ...
    @property
    def filters(self) -> Sequence[Array] | None: ...
    @property
    def variance(self) -> float: ...


@dataclass(frozen=True, eq=False)
class Cells:
    """Experiments laid end to end; `cell` (rows,) is each row's, `part` and `block` (cells,) are
    each cell's.
    """

    parts: Sequence[Experiment]
    joined: Joined
    Y: Array
    cell: Integers
    part: Integers
    block: Integers

    @classmethod
    def of(cls, parts: Sequence[Experiment], block: Integers | None = None) -> Cells:
        """With the block of each row (None: all in one)."""
        joined = Joined.of(parts)
        part = np.repeat(np.arange(len(parts)), np.diff(joined.starts))
        block = np.zeros(len(part), dtype=np.int64) if block is None else block
        # A cell ends where the window or the block changes.
        new = np.r_[True, (np.diff(part) != 0) | (np.diff(block) != 0)]
        return cls(
            parts,
            joined,
            np.concatenate([e.Y for e in parts]),
            np.cumsum(new) - 1,
            part[new],
            block[new],
        )


@dataclass(frozen=True, eq=False)
class Problem:
    """A model's free parameters, within `lower` and `upper`, and first states to be fitted to cells
    in a unit, with so many integration steps a sample of each window.
    """

    simulator: Simulator
    cells: Cells
    unit: _Unit
    substeps: Integers
    lower: Array
    upper: Array

    @classmethod
    def of(
        cls, simulator: Simulator, cells: Cells, unit: _Unit, substeps: Sequence[int]
    ) -> Problem:
        """With the bounds that the model gives."""
        values = simulator.model.all_parameters
        free = [values[name] for name in simulator.model.free]
        lower = [parameter.lower for parameter in free]
        upper = [parameter.upper for parameter in free]
        return cls(
            simulator,
            cells,
            unit,
            np.array(substeps),
            np.array(lower, dtype=float),
            np.array(upper, dtype=float),
        )

    @property
    def parameters(self) -> tuple[str, ...]:
        """Full names of those that are free."""
        return tuple(self.simulator.model.free)

    @cached_property
    def priors(self) -> Priors:
        """Of the parameters, in the unit's squares."""
        return Priors.of(self.simulator.model.all_parameters, self.parameters, self.unit.variance)

    @cached_property
    def columns(self) -> Integers:
        """Kernel columns of the parameters, then of the first states."""
        return self.simulator.columns(
            [*self.parameters, *(f"initial:{n}" for n in self.simulator.free_states)]
        )

    @cached_property
    def free(self) -> Array:
        """0 for first states that an experiment knows, else 1, shape (windows, columns)."""
        free = np.ones((len(self.cells.parts), len(self.columns)))
        for own, e in zip(free[:, len(self.parameters) :], self.cells.parts, strict=True):
            own[:] = [name not in e.known for name in self.simulator.free_states]
        return free

    @cached_property
    def filters(self) -> Array:
        """Those of the outputs, filled up with zeros, shape (outputs, order + 1)."""
        # Of one length for compiled code; a zero does nothing.
        coefficients = self.unit.filters
        out = np.zeros(
            (self.cells.Y.shape[1], 1 if coefficients is None else max(map(len, coefficients)))
        )
        for o, a in enumerate(coefficients or ()):
            out[o, : len(a)] = a
        return out

    def begin(self, X0: Array) -> Fit:
        """The fit at the model's own values."""
        return self.at(
            np.array([self.simulator.model.values[name] for name in self.parameters]), X0
        )

    def p(self, theta: Array) -> Array:
        """All parameters in the kernel's order."""
        p = self.simulator.p()
        # The first columns of the kernel are its parameters: one that is free has its own number
        # there.
        p[self.columns[: len(theta)]] = theta
        return p

    def at(self, theta: Array, X0: Array, *, slopes: bool = True) -> Fit:
        """One pass at parameters and first states; without slopes for the cost alone."""
        # Slopes take most of a pass: a trial that may be refused asks for none.
        at = self.cells.joined
        columns = self.columns if slopes else self.columns[:0]
        p = self.p(theta)
        M = np.empty(
            (len(self.cells.part), self.cells.Y.shape[1], len(columns) + 1, len(columns) + 1)
        )
        power = np.empty(M.shape[:2])
        count_samples(int(np.diff(at.starts) @ self.substeps) * (1 + len(columns)))
        system = self.simulator.kernel.system
        unit = self.unit
        of = self.cells
        # A machine that cannot be is not simulated: its cost is infinite as that of one that
        # diverges.
        with self.simulator.settled(p) as settled:
            possible = (
                settled
                and self.simulator.possible(p)
                and _accumulated(
                    *(system, at.U, of.Y, unit.weights, self.filters, unit.clip, at.starts, p, X0),
                    *(
                        at.sample_times,
                        self.substeps,
                        at.holds,
                        at.follows,
                        self.free,
                        columns,
                        of.cell,
                        M,
                        power,
                    ),
                )
            )
        return Fit(
            self,
            theta,
            X0,
            M,
            power,
            float(power.sum()) + self.priors.cost(theta) if possible else np.inf,
        )


@dataclass(frozen=True, eq=False)
class Fit:
    """A problem at parameters `theta` and first states `X0` (windows, states): the normal equations
    M (cells, outputs, m, m) and Huber's `power` (cells, outputs), whose sum with the priors' is the
    `cost`; that is infinite where the model diverges.
    """

    problem: Problem
    theta: Array
    X0: Array
    M: Array
    power: Array
    cost: float

    @cached_property
    def model(self) -> PhysicalModel:
        """With the values here."""
        return self.problem.simulator.model.with_values(
            dict(zip(self.parameters, self.theta.tolist(), strict=True))
        )

    @property
    def parameters(self) -> tuple[str, ...]:
        """Full names of what `theta` holds."""
        return self.problem.parameters

    @property
    def substeps(self) -> tuple[int, ...]:
        """Integration steps a sample of each window."""
        return tuple(self.problem.substeps.tolist())

    @property
    def weights(self) -> Array:
        """1/σ of each output."""
        return self.problem.unit.weights

    @property
    def priors(self) -> Priors:
        """Of the parameters, in the unit's squares."""
        return self.problem.priors

    @property
    def initial(self) -> list[Array]:
        """First states of each window."""
        return list(self.X0)

    def in_unit(self, unit: _Unit) -> Fit:
        """The same values, their errors measured in another unit."""
        return replace(self.problem, unit=unit).at(self.theta, self.X0)

    @property
    def mean(self) -> float:
        """Cost of a measured value, in the mean."""
        return self.cost / max(self.samples, 1)

    @property
    def samples(self) -> int:
        """Measured values that count."""
        return int(np.isfinite(self.problem.cells.Y[:, self.weights > 0.0]).sum())

    @cached_property
    def residuals(self) -> list[Array]:
        """What was measured less what is simulated, of each window, in the outputs' units: NaN
        where a sample is missing.
        """
        at = self.problem
        # Simulated once more: a pass keeps no trajectory.
        runs = at.simulator.run_each(
            at.cells.parts, self.initial, at.p(self.theta), substeps=self.substeps
        )
        return runs.errors_of_each

    @cached_property
    def std(self) -> Array:
        """Standard deviations of the parameters, infinite along flat directions."""
        q = len(self.theta)
        H = eliminated(
            self.M, self.problem.cells.part, len(self.X0), q, np.ones(len(self.power)), 0.0
        )[0]
        # Each prior is a measurement more, each free first state an unknown more.
        unknowns = q + int(self.problem.free[:, q:].sum()) - self.priors.count
        H[np.diag_indices(q)] += self.priors.precisions
        covariance, _ = covariance_of(
            H, self.cost / max(self.samples - unknowns, 1), self.parameters, self.theta
        )
        return np.sqrt(np.diag(covariance))

    @property
    def felt(self) -> int:
        """First states of the model's own, over all windows, that an output feels."""
        simulator, q = self.problem.simulator, len(self.theta)
        own = len(simulator.free_states) - len(simulator.kernel.deviating)
        squares = np.einsum("coii->ci", self.M)[:, q : q + own]
        by_window = np.zeros((len(self.X0), own))
        np.add.at(by_window, self.problem.cells.part, squares)
        return int(np.count_nonzero(by_window))

    def step(
        self, use: Array | None = None, damping: float = 0.0, ridge: float = 0.0
    ) -> tuple[Array, Array]:
        """Changes of the parameters within their bounds, fitted to cells weighed `use` (None: all
        alike), and of the first states, which stay fitted to all rows of their window. `damping`
        raises the diagonals of both, `ridge` that of the parameters alone.
        """
        part = self.problem.cells.part
        use = np.ones(len(self.power)) if use is None else use
        try:
            H, g, E = eliminated(self.M, part, len(self.X0), len(self.theta), use, damping)
            # Priors count in the parameters only: first states have none.
            g += self.priors.pull(self.theta)
            H[np.diag_indices(len(g))] = np.maximum(np.diag(H) + self.priors.precisions, 0.0) * (
                1.0 + damping + ridge
            )
            move = bounded_step(H, g, self.theta, self.problem.lower, self.problem.upper)
        except (ValueError, np.linalg.LinAlgError):
            # eigenvalues that are not found: next to an overflow
            return np.zeros(len(self.theta)), np.zeros(
                (len(self.X0), self.M.shape[-1] - 1 - len(self.theta))
            )
        # Rounding may lead past a bound by its last digit.
        move = np.clip(self.theta + move, self.problem.lower, self.problem.upper) - self.theta
        # First states answer the error that is there, less what the move of the parameters takes of
        # it.
        return move, E[:, :, -1] - E[:, :, :-1] @ move

    def predicted(self, move: Array, firsts: Array) -> Array:
        """Power (cells, outputs) after such changes, if the outputs go on as they begin to and no
        error passes its limit.
        """
        return _predicted(self.M, self.power, self.problem.cells.part, move, firsts)

    def promised(self, move: Array, firsts: Array) -> float:
        """By how much the cost falls then."""
        return (
            self.cost
            - float(self.predicted(move, firsts).sum())
            - self.priors.cost(self.theta + move)
        )

    def moved(self, move: Array, firsts: Array) -> tuple[Array, Array]:
        """Parameters and first states after such changes."""
        X0 = self.X0.copy()
        at = self.problem.simulator
        X0[:, [at.states.index(name) for name in at.free_states]] += firsts
        return self.theta + move, X0

    def descended(self, steps: int, tolerance: float) -> Fit:
        """So many steps down at most, or until one promises or gains less than the part `tolerance`
        of the cost.
        """
        if self.cost == np.inf or not len(self.problem.columns):
            return self
        return descend(
            _Downhill(self.problem, tolerance), self, steps=steps, relative=tolerance
        ).point

    def without(self, out: npt.NDArray[np.bool_], ridge: float, steps: int = 1) -> Fit:
        """The fit without the cells `out` (cells,), by simulated steps from this one, each
        shortened until the other cells are fitted no worse. Parameters that the others leave nearly
        undetermined are held by the `ridge`; first states stay fitted to all rows.
        """
        use = np.where(out, 0.0, 1.0)
        fit = self
        for _ in range(steps if len(self.theta) else 0):
            # From the whole step to one damped eleven times: the first that fits the other cells no
            # worse.
            for damping in SHORTENED:
                trial = self.problem.at(*fit.moved(*fit.step(use, damping, ridge)))
                if trial.cost < np.inf and trial._cost_of(use) <= fit._cost_of(use):
                    fit = trial
                    break
        return fit.with_states_refitted()

    def _cost_of(self, use: Array) -> float:
        """Of cells weighed so, and of the priors."""
        return float(use @ self.power.sum(axis=1)) + self.priors.cost(self.theta)

    def with_states_refitted(self) -> Fit:
        """First states once more fitted to all rows of their window, parameters held, where that
        helps.
        """
        # Bounds at the values themselves: the step then moves first states alone.
        held = replace(self, problem=replace(self.problem, lower=self.theta, upper=self.theta))
        refitted = self.problem.at(*held.moved(*held.step()), slopes=False)
        return refitted if refitted.cost < self.cost else self


@dataclass(frozen=True, eq=False)
class _Downhill:
    """The landscape of a descent that ends where a step promises less than a part of the cost."""

    problem: Problem
    tolerance: float

    def trial(self, point: Fit, damping: float) -> tuple[Array, Array] | None:
        """The first damped step that promises enough. One that a bound cuts short may promise a
        rise: a shorter one will not.
        """
        for _ in range(ATTEMPTS):
            change = point.step(damping=damping)
            promised = point.promised(*change)
            # It would not pay: the descent ends here, at a part of its own tolerance.
            if 0.0 <= promised < PROMISED * self.tolerance * point.cost:
                break
            if promised > 0.0:
                return point.moved(*change)
            # A rise is promised: a bound cuts the step short in a direction that helped.
            damping *= HARDER
        return None

    def cost(self, trial: tuple[Array, Array]) -> float:
        """Without slopes."""
        return self.problem.at(*trial, slopes=False).cost

    def point(self, trial: tuple[Array, Array]) -> Fit:
        """With slopes."""
        return self.problem.at(*trial)

    def ends(self, point: Fit) -> End | None:
        """Nothing but what a step promises ends it."""
        return None


@njit(error_model="numpy")
def _accumulated(
    q,
    U,
    Y,
    weights,
    filters,
    clip,
    starts,
    p,
    X0,
    sample_times,
    substeps,
    holds,
    follows,
    free,
    columns,
    cell,
    M,
    power,
):
    """One pass over all windows, adding up M and Huber's cost `power`; False where the model
    diverges.
    """
    # order: coefficients of the longest whitening filter, its leading 1 among them.
    count = columns.shape[0]
    ny = q.sizes[3]
    order = filters.shape[1]
    w = new_memory(q, count)
    memory = np.zeros((q.remembered.shape[0], count + 1))
    X = np.zeros((AT_ONCE + 1, q.sizes[0]))
    simulated = np.zeros((AT_ONCE + 1, ny))
    dY = np.zeros((AT_ONCE + 1, ny, count))
    # A ring of the last rows (∂y, e) of each output, as long as its filter.
    past = np.zeros((ny, order, count + 1))
    v = np.zeros(count + 1)
    M[:] = 0.0
    power[:] = 0.0
    for j in range(X0.shape[0]):
        a = starts[j]
        b = starts[j + 1]
        # Filters begin anew in each window: what went before is another piece of the record.
        past[:] = 0.0
        begin(q, w, U, starts, j, p, X0, sample_times, holds, follows, columns, memory)
        for first in range(0, b - a, AT_ONCE):
            # One sample further than the products go, for the state to stand at the next part's
            # beginning.
            last = min(first + AT_ONCE, b - a - 1)
            integrate(
                q,
                w,
                U[a:b],
                first,
                last,
                sample_times[j],
                substeps[j],
                holds[j],
                p,
                columns,
                X,
                simulated,
                dY,
            )
            # At once: what the cost would be is infinite anyway.
            if not np.isfinite(w.x).all():
                return False
            for k in range(first, min(first + AT_ONCE, b - a)):
                for o in range(ny):
                    if weights[o] == 0.0:
                        continue
                    now = past[o, k % order]
                    # A missing sample leaves zeros in the ring: filters pass over it as over a
                    # perfect fit.
                    now[:] = 0.0
                    if not np.isfinite(Y[a + k, o]):
                        continue
                    now[count] = (Y[a + k, o] - simulated[k - first, o]) * weights[o]
                    # Its square would overflow. Not `>=`, so that NaN ends it too.
                    if not abs(now[count]) < OVERFLOW:
                        return False
                    for i in range(count):
                        now[i] = dY[k - first, o, i] * weights[o] * free[j, i]
                    # v = A(z⁻¹)·(∂y, e): whitened rows, so that plain sums are the noise's own
                    # likelihood.
                    v[:] = now
                    for lag in range(1, min(order, k + 1)):
                        v += filters[o, lag] * past[o, (k - lag) % order]
                    e = abs(v[count])
                    # Huber: beyond the clip the weight falls as 1/|e|, so the influence of one
                    # sample is bounded.
                    _add(M[cell[a + k], o], v, min(1.0, clip[o] / max(e, 1e-300)))
                    power[cell[a + k], o] += (
                        # The cost belongs to these weights: quadratic, then linear, with one slope
                        # where they meet.
                        e * e if e <= clip[o] else clip[o] * (2.0 * e - clip[o])
                    )
    for i in range(count + 1):
        # Only the lower triangle was added up.
        M[:, :, :i, i] = M[:, :, i, :i]
    return np.isfinite(M).all()


@njit(error_model="numpy", inline="always")
def _add(M, v, weight):
    """The lower triangle of v vᵀ, weighed."""
    for i in range(v.shape[0]):
        scaled = weight * v[i]
        for k in range(i + 1):
            M[i, k] += scaled * v[k]


@njit(error_model="numpy")
def eliminated(M, part, parts, q, use, damping):
    """H (q, q) and g (q,) of the cells weighed `use`, and E (parts, states, q + 1), which all rows
    of a window say.
    """
    c = M.shape[2] - 1
    E = np.zeros((parts, M.shape[2] - 1 - q, q + 1))
    # First states are fitted to all cells of their window, whatever `use` leaves out.
    if c > q:
        W = _by_part(M, part, parts, np.ones(M.shape[0]))
        own = W[:, q:c, q:c].copy()
        right = np.zeros(E.shape)
        right[:, :, :q] = W[:, q:c, :q]
        right[:, :, q] = W[:, q:c, c]
        for i in range(c - q):
            # The same damping as that of the parameters: a step is short in all that moves.
            own[:, i, i] *= 1.0 + damping
        E[:] = solved(own, right, NOTHING_ALONG)
    W = _by_part(M, part, parts, use)
    z = np.zeros((c + 1, q + 1))
    whole = np.zeros((q + 1, q + 1))
    for i in range(q):
        z[i, i] = 1.0
    # z = (I, −E): how parameters, first states and the error change together.
    z[c, q] = 1.0
    for j in range(parts):
        z[q:c] = -E[j]
        whole += z.T @ (W[j] @ z)
    return whole[:q, :q].copy(), whole[:q, q].copy(), E


@njit(error_model="numpy")
def _by_part(M, part, parts, use):
    """Sums over the outputs and the cells of each window, weighed `use`."""
    W = np.zeros((parts, M.shape[2], M.shape[2]))
    for i in range(M.shape[0]):
        for o in range(M.shape[1]):
            W[part[i]] += use[i] * M[i, o]
    return W


@njit(error_model="numpy")
def _predicted(M, power, part, move, firsts):
    """Power after changes of the parameters and of the first states of each window."""
    q = move.shape[0]
    c = M.shape[2] - 1
    d = np.zeros(M.shape[2] - 1)
    out = np.empty_like(power)
    for i in range(M.shape[0]):
        d[:q] = move
        d[q:] = firsts[part[i]]
        for o in range(M.shape[1]):
            # Power + dᵀM d − 2 dᵀ(Jᵀe): what the quadratic model leaves. No power is below zero.
            out[i, o] = max(
                power[i, o]
                + np.sum(d * (M[i, o, :c, :c] * d).sum(axis=1))
                - 2.0 * np.sum(d * M[i, o, :c, c]),
                0.0,
            )
    return out
