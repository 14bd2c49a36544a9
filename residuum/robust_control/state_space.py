"""State-space form of a weighted loop, kept as a chain of small blocks so that long impulse responses stay well conditioned."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import block_diag

from residuum.identification.errors import BadInput
from residuum.identification.linear_models.transfer_function import TransferFunction

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class StateSpace:
    """x(k+1) = A x + B u, y = C x + D u; shapes (n, n), (n, m), (p, n), (p, m).

    Raises BadInput when the shapes do not fit together.

    >>> integrator = StateSpace(np.eye(1), np.eye(1), np.eye(1), np.zeros((1, 1)))
    >>> complex(integrator.response(np.array([-1.0 + 0j]))[0, 0, 0])
    (-0.5+0j)
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray

    def __post_init__(self) -> None:
        n, (p, m) = len(self.A), self.D.shape
        if (self.A.shape, self.B.shape, self.C.shape) != ((n, n), (n, m), (p, n)):
            shapes = f"A {self.A.shape}, B {self.B.shape}, C {self.C.shape}, D {self.D.shape}"
            raise BadInput(f"StateSpace: {shapes}; must be (n, n), (n, m), (p, n), (p, m)")

    def response(self, z: ComplexArray) -> ComplexArray:
        """H(z) = C (zI − A)⁻¹ B + D, shape (len(z), p, m)."""
        resolvent = z[:, None, None] * np.eye(len(self.A)) - self.A
        return np.asarray(self.C @ np.linalg.solve(resolvent, np.broadcast_to(self.B, (len(z), *self.B.shape))) + self.D)

    def is_stable(self) -> bool:
        """Whether every eigenvalue of A lies inside the unit circle."""
        return bool(np.all(np.abs(np.linalg.eigvals(self.A)) < 1.0))


def realise(system: TransferFunction) -> StateSpace:
    """Companion form of a proper discrete-time transfer function."""
    if system.sample_time is None or not system.is_proper:
        raise BadInput("state space: needs a proper discrete-time transfer function")
    n = len(system.den) - 1
    den = system.den / system.den[0]
    num = np.concatenate([np.zeros(n + 1 - len(system.num)), system.num]) / system.den[0]
    A = np.eye(n, k=-1)
    A[:1] = -den[1:]
    return StateSpace(A, np.eye(n, 1), (num[1:] - num[0] * den[1:])[None, :], np.array([[num[0]]]))


def interconnect(blocks: Sequence[StateSpace], between: FloatArray, external: FloatArray, outputs: FloatArray) -> StateSpace:
    """Blocks side by side with inputs v and outputs w, joined by v = `between` w + `external` r, z = `outputs` w.

    The states stay those of the blocks, so no polynomials are multiplied out.

    Raises
    ------
    BadInput
        The loop without delay has gain 1 (I − F D is singular): it has no solution.
    """
    A, B, C, D = (block_diag(*[getattr(block, name) for block in blocks]) for name in "ABCD")
    direct = np.eye(len(between)) - between @ D
    if abs(np.linalg.det(direct)) < 1e-12:
        raise BadInput("state space: the loop is not well posed; its direct feedthrough equals −1")
    from_states, from_input = np.linalg.solve(direct, between @ C), np.linalg.solve(direct, external)
    return StateSpace(A + B @ from_states, B @ from_input, outputs @ (C + D @ from_states), outputs @ D @ from_input)


def weighted_loop(
    plant: TransferFunction,
    controller: TransferFunction,
    W_S: TransferFunction | None = None,
    W_T: TransferFunction | None = None,
    W_K: TransferFunction | None = None,
) -> StateSpace:
    """From the reference to [W_S S; W_T T; W_K K S], the rows whose weight is given.

    Raises BadInput when no weight is given, or for unequal sample times.
    """
    weights = [weight for weight in (W_S, W_T, W_K) if weight is not None]
    if not weights or len({system.sample_time for system in (plant, controller, *weights)}) != 1:
        raise BadInput("weighted loop: needs a weight, and one sample time for plant, controller and weights")
    blocks = [realise(system) for system in (controller, plant, *weights)]
    n = len(blocks)
    between, external = np.zeros((n, n)), np.zeros((n, 1))
    between[0, 1], external[0] = -1.0, 1.0  # K is driven by e = r − y
    between[1, 0] = 1.0
    row = 2
    if W_S is not None:
        between[row, 1], external[row] = -1.0, 1.0
        row += 1
    if W_T is not None:
        between[row, 1] = 1.0
        row += 1
    if W_K is not None:
        between[row, 0] = 1.0
    return interconnect(blocks, between, external, np.eye(n)[2:])
