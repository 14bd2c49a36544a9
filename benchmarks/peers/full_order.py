"""The controller of full order, by slycot where it is installed: what the structure of a controller costs."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.identification.errors import BadInput
from residuum.identification.linear_models.state_space import StateSpace
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.robust_control.certificates import h_infinity_norm
from residuum.robust_control.loop import interconnect

FloatArray = npt.NDArray[np.float64]

_LARGEST_ORDER = 60
_ROOT = 2.0**0.5
_SLYCOT = """
import json, sys
try:
    import numpy as np
    from slycot import sb10ad
except ImportError:
    sys.exit(3)
A, B, C, D = (np.array(m, dtype=float) for m in json.load(sys.stdin))
n, m, p = len(A), B.shape[1], C.shape[0]
out = sb10ad(n, m, p, 1, 1, 100.0, A, B, C, D)
json.dump([float(out[0]), *(np.atleast_2d(k).tolist() for k in out[1:5])], sys.stdout)
"""
_NOT_INSTALLED = 3


@dataclass(frozen=True, eq=False)
class FullOrder:
    """Result: the controller in state space, its order, the norm of the loop that it closes, and the norm that slycot reported.

    `norm` is computed anew from the closed loop, infinite when that is unstable. Only when both agree is it the smallest that any
    controller reaches.
    """

    controller: StateSpace
    norm: float
    reported: float

    @property
    def is_bound(self) -> bool:
        """Whether slycot's number is confirmed, so that no controller does better."""
        return bool(np.isfinite(self.norm) and abs(self.norm / self.reported - 1.0) < 1e-3)


class NotAvailable(BadInput):
    """Slycot is not installed, found no controller, or took too long; the structured design does not need it."""


def full_order_design(
    plant: TransferFunction,
    W_S: TransferFunction,
    W_T: TransferFunction,
    *,
    timeout: float = 30.0,
    python: str = sys.executable,
) -> FullOrder:
    """Minimise ‖[W_S S; W_T T]‖∞ over all controllers (Doyle, Glover, Khargonekar, Francis; SLICOT's SB10AD).

    The generalised plant goes through the bilinear map s = (z − 1)/(z + 1), which keeps the norm, and the controller back. SLICOT
    runs in a process of its own that ends after `timeout` [s]: on badly posed problems it is known to loop.

    Parameters
    ----------
    plant, W_S, W_T : TransferFunction
        Discrete-time; the weights stable and proper.
    python : str
        The interpreter that has slycot.

    Raises
    ------
    NotAvailable
        Not installed (`pip install slycot`), failed, timed out, or more than 60 states.
    BadInput
        Not in discrete time, different sample times.
    """
    if len({system.sample_time for system in (plant, W_S, W_T)}) != 1:
        raise BadInput("full-order design: plant and weights must have one sample time")
    general = generalised_plant(plant, W_S, W_T)
    if len(general.A) > _LARGEST_ORDER:
        raise NotAvailable(
            f"full-order design: {len(general.A)} states; at most {_LARGEST_ORDER} are taken"
        )
    continuous = _to_continuous(general)
    matrices = json.dumps(
        [m.tolist() for m in (continuous.A, continuous.B, continuous.C, continuous.D)]
    )
    try:
        done = subprocess.run(
            [python, "-c", _SLYCOT],
            input=matrices,
            capture_output=True,
            text=True,
            timeout=timeout,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise NotAvailable(f"full-order design: slycot took longer than {timeout:g} s") from None
    if done.returncode:
        installed = (
            "slycot is not installed"
            if done.returncode == _NOT_INSTALLED
            else "slycot found no controller"
        )
        raise NotAvailable(f"full-order design: {installed}")
    reported, *parts = json.loads(done.stdout)
    controller = _to_discrete(
        StateSpace(*(np.array(part, dtype=float) for part in parts), general.sample_time)
    )
    closed = interconnect(
        [general, controller],
        np.array([[0.0, 0, 0, 0], [0, 0, 0, 1], [0, 0, 1, 0]]),
        np.array([[1.0], [0.0], [0.0]]),
        np.eye(4)[:2],
    )
    norm = h_infinity_norm(closed)[0] if closed.is_stable else float("inf")
    return FullOrder(controller, norm, float(reported))


def generalised_plant(
    plant: TransferFunction, W_S: TransferFunction, W_T: TransferFunction
) -> StateSpace:
    """From (r, u) to (W_S e, W_T y, e) with y = G u and e = r − y."""
    blocks = [StateSpace.from_transfer_function(system) for system in (plant, W_S, W_T)]
    blocks.append(StateSpace.gain(1.0, blocks[0].sample_time))
    between = np.zeros((4, 4))
    between[1, 0], between[2, 0] = -1.0, 1.0
    external = np.array([[0.0, 1.0], [1.0, 0.0], [0.0, 0.0], [1.0, 0.0]])
    outputs = np.array([[0.0, 1, 0, 0], [0, 0, 1, 0], [-1, 0, 0, 1]])
    return interconnect(blocks, between, external, outputs)


def _to_continuous(system: StateSpace) -> StateSpace:
    """By s = (z − 1)/(z + 1)."""
    return _bilinear(system, 1.0)


def _to_discrete(system: StateSpace) -> StateSpace:
    """By z = (1 + s)/(1 − s)."""
    return _bilinear(system, -1.0)


def _bilinear(system: StateSpace, sign: float) -> StateSpace:
    unit = np.eye(len(system.A))
    inverse: FloatArray = np.asarray(np.linalg.inv(unit + sign * system.A), dtype=np.float64)
    D = system.D - sign * system.C @ inverse @ system.B
    return StateSpace(
        inverse @ (system.A - sign * unit),
        _ROOT * inverse @ system.B,
        _ROOT * system.C @ inverse,
        D,
        system.sample_time,
    )
