"""Response of a model, linearised along a trajectory, to a term that varies in time in one of its balances."""

# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.physics import Experiment, PhysicalModel, Simulator
from residuum.identification.physics.model import missing_name
from residuum.identification.physics.simulate.integration import integrate, new_memory, observe, observe_slopes
from residuum.kept_loops import njit


@dataclass(frozen=True, eq=False)
class LinearResponse:
    """z(k+1) = F(k) z(k) + G(k) w(k), δy(k) = C(k) z(k) + D(k) w(k), one column a balance. Over a sample, w counts with the
    mean of its two ends.

    `X` (n, states) is the trajectory; F (n, states, states + balances) holds F and G, C (n, outputs, states + balances) C and D.
    """

    balances: tuple[str, ...]
    X: FloatArray
    F: FloatArray
    C: FloatArray

    def to(self, balance: str, terms: FloatArray) -> FloatArray:
        """Change of the outputs for terms (n, m) in the balance's unit added to its sum, shape (n, outputs, m)."""
        return np.asarray(_respond(self.F, self.C, self.balances.index(balance), np.ascontiguousarray(terms)))


def linear_response(model: PhysicalModel, experiment: Experiment, x0: FloatArray, substeps: int) -> LinearResponse:
    """Linearise the model along its simulation from x0."""
    simulator = Simulator(model)
    names = [f"initial:{name}" for name in simulator.states] + [missing_name(balance) for balance in model.balances]
    columns, p = simulator.columns(names), simulator.p()
    X = simulator.run_vectors(experiment, x0, p, substeps=substeps).X
    arguments = (experiment.U, X, p, columns, experiment.sample_time, substeps, experiment.hold)
    F, C = _transitions(simulator.kernel.system, *arguments)
    return LinearResponse(tuple(model.balances), X, F, C)


@njit(error_model="numpy")
def _transitions(q, U, X, p, columns, sample_time, substeps, hold):
    n, nx, m = X.shape[0], X.shape[1], columns.shape[0]
    F, C = np.zeros((n, nx, m)), np.zeros((n, q.sizes[3], m))
    w, y, none, none3 = new_memory(q, m), np.zeros(q.sizes[3]), np.zeros((0, 0)), np.zeros((0, 0, 0))
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
def _respond(F, C, balance, terms):
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
                following[i, c] = 0.5 * F[k, i, nx + balance] * (terms[k, c] + terms[min(k + 1, n - 1), c])
                for j in range(nx):
                    following[i, c] += F[k, i, j] * z[j, c]
        z[:] = following
    return out
