"""A weighted loop in state space, kept as a chain of small blocks so that long impulse responses stay well conditioned."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import block_diag

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput
from residuum.identification.linear_models.state_space import StateSpace
from residuum.identification.linear_models.transfer_function import TransferFunction


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
    C, D = outputs @ (C + D @ from_states), outputs @ D @ from_input
    return StateSpace(A + B @ from_states, B @ from_input, C, D, blocks[0].sample_time)


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
    blocks = [StateSpace.from_transfer_function(system) for system in (controller, plant, *weights)]
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
