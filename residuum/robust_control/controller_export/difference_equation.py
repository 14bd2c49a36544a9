"""The difference equation of a controller with saturation, and the vector that an implementation is tested with."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput
from residuum.identification.linear_models.transfer_function import TransferFunction


@dataclass(frozen=True, eq=False)
class DifferenceEquation:
    r"""u(k) = sat(Σ b_i e(k−i) − Σ a_i u(k−i)), i = 0…n and 1…n.

    The past u on the right are the saturated ones: the equation goes on from what the actuator did, which is conditioned
    anti-windup (R. Hanus, M. Kinnaert, J.-L. Henrotte, *Conditioning technique*, Automatica 23 (1987) 729–739). Without
    saturation it is K(z) exactly.

    Parameters
    ----------
    controller : TransferFunction
        K(z), proper.
    lower, upper : float
        Limits of the actuator in the unit of u; infinite when there are none.

    Raises
    ------
    BadInput
        Continuous-time or improper controller, lower ≥ upper.

    Examples
    --------
    >>> integral = DifferenceEquation(TransferFunction([0.5, 0.0], [1.0, -1.0], 1.0), -1.0, 1.0)
    >>> integral.run(np.array([1.0, 1.0, 1.0, 1.0, -1.0])).tolist()
    [0.5, 1.0, 1.0, 1.0, 0.5]
    """

    controller: TransferFunction
    lower: float = -math.inf
    upper: float = math.inf

    def __post_init__(self) -> None:
        if self.controller.sample_time is None or not self.controller.is_proper:
            raise BadInput("controller export: the controller must be discrete-time and proper")
        if not self.lower < self.upper:
            raise BadInput(f"controller export: limits {self.lower!r} and {self.upper!r}; the lower must be below the upper")

    @property
    def sample_time(self) -> float:
        """Ts [s]."""
        return float(self.controller.sample_time or 0.0)

    @property
    def b(self) -> FloatArray:
        """b_0 … b_n, of e."""
        missing = len(self.controller.den) - len(self.controller.num)
        return np.concatenate([np.zeros(missing), self.controller.num]) / self.controller.den[0]

    @property
    def a(self) -> FloatArray:
        """a_1 … a_n, of u."""
        return np.asarray(self.controller.den[1:] / self.controller.den[0])

    @property
    def order(self) -> int:
        """n."""
        return len(self.a)

    def run(self, e: npt.ArrayLike) -> FloatArray:
        """u for the control error e from rest, shape (n,)."""
        e = np.asarray(e, dtype=float)
        padded, u = np.concatenate([np.zeros(self.order), e]), np.zeros(self.order + len(e))
        b, a = self.b[::-1], self.a[::-1]
        for k in range(len(e)):
            wanted = b @ padded[k : k + self.order + 1] - a @ u[k : k + self.order]
            u[k + self.order] = min(max(wanted, self.lower), self.upper)
        return u[self.order :]

    def text(self) -> str:
        """The equation in words of one line."""
        terms = [f"{value:+.17g} e(k{_lag(i)})" for i, value in enumerate(self.b)]
        terms += [f"{-value:+.17g} u(k{_lag(i)})" for i, value in enumerate(self.a, start=1)]
        wanted = " ".join(terms)
        bounded = math.isfinite(self.lower) or math.isfinite(self.upper)
        return f"u(k) = sat({wanted}; {self.lower:g}, {self.upper:g})" if bounded else f"u(k) = {wanted}"

    def self_test(self, samples: int = 24) -> tuple[FloatArray, FloatArray]:
        """(e, u): a step up that reaches a finite limit where there is one, a step back, a ramp and zero."""
        shape = np.concatenate([np.ones(8), -np.ones(6), np.linspace(-1.0, 1.0, 6), np.zeros(max(0, samples - 20))])[:samples]
        wanted = np.abs(DifferenceEquation(self.controller).run(shape)).max()
        limits = [abs(limit) for limit in (self.lower, self.upper) if math.isfinite(limit) and limit != 0]
        e = shape * (2.0 * max(limits) / wanted if limits and wanted > 0 else 1.0)
        return e, self.run(e)


def _lag(i: int) -> str:
    return "" if i == 0 else f"−{i}"
