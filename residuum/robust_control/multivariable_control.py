"""Control of a plant with as many outputs as inputs: static decoupling, a loop an output, and one
certificate for the whole.

With D = G(1)⁻¹ the plant G_k D of every drawn model is close to the diagonal Λ = diag (G D)_ii of
the nominal one,

.. math:: G_k D = \\Lambda (I + E_k), \\qquad \\det(I + G_k D C) = \\det(I + \\Lambda C)\\,\\det(I +
T E_k),

C = diag C_i the controllers and T = diag T_i their loops. So all loops together are stable for
every drawn model if each T_i is and

.. math:: |T_i(\\omega)| \\sum_j |W_{ij}(\\omega)| < 1, \\qquad |W_{ij}| \\ge \\max_k |(E_k)_{ij}|
\text{ at every frequency.}

Interactions count as uncertainty of the loop they enter, and each loop is then one of one input and
one output (Algorithm 2).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.blas_threads import LARGEST_FOR_ONE_THREAD, one_thread_if_small
from residuum.identification.errors import BadInput
from residuum.identification.kernel_based.multivariable import MultivariableModel
from residuum.identification.linear_models.error_bounds.error_models import (
    DrawnErrors,
    refined_grid,
)
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.identification.linear_models.uncertainty import weight_above
from residuum.robust_control.certificates import Measured, assess
from residuum.robust_control.control_problem import WeightChoice, Wishes, critical_frequency
from residuum.robust_control.loop import Loop, frequency_grid
from residuum.robust_control.synthesis.constrained_structure import ControllerStructure, Point
from residuum.robust_control.synthesis.structured_synthesis import Synthesis
from residuum.robust_control.weights.performance_weight import (
    Infeasible,
    NominalAim,
    design_for_nominal_performance,
)

# Step responses of a decoupled multivariable loop, of the nominal plant and of drawn ones, by
# difference equations.


def closed_loop_steps(
    taps: FloatArray,
    decoupler: FloatArray,
    controllers: Sequence[TransferFunction],
    reference: int,
    n: int,
) -> FloatArray:
    """Outputs of u = D diag(C_i) (r − y) when one reference steps from 0 to 1, shape (plants, n,
    p).

    Parameters
    ----------
    taps : array, shape (plants, p, q, length)
        Impulse responses from lag 0 on; those of lag 0 are zero.
    decoupler : array, shape (q, p)
    controllers : sequence of TransferFunction
        C_i, one an output.
    reference : int
        Index of the output whose reference steps.
    """
    count, p, q, length = taps.shape
    # the convolution of each sample as one product over all inputs and lags
    rows = taps[..., ::-1].reshape(count, p, q * length)  # oldest input first
    y, e, v = (np.zeros((count, p, n)) for _ in range(3))
    u = np.zeros((count, q, n + length - 1))
    laws = [_coefficients(controller) for controller in controllers]
    # An unstable plant grows beyond all numbers here, and is counted by its infinite error.
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(n):
            past = u[:, :, k : k + length].reshape(count, q * length)
            y[:, :, k] = np.einsum("npm,nm->np", rows, past)
            e[:, :, k] = -y[:, :, k]
            e[:, reference, k] += 1.0
            for i, (b, a) in enumerate(laws):
                v[:, i, k] = _recent(e[:, i], b, k, 0) - _recent(v[:, i], a, k, 1)
            u[:, :, k + length - 1] = v[:, :, k] @ decoupler.T
    return np.moveaxis(y, 1, 2)


def _coefficients(controller: TransferFunction) -> tuple[FloatArray, FloatArray]:
    """b from lag 0 on, a from lag 1 on."""
    lag = len(controller.den) - len(controller.num)
    return (
        np.r_[np.zeros(lag), controller.num] / controller.den[0],
        controller.den[1:] / controller.den[0],
    )


def _recent(values: FloatArray, weights: FloatArray, k: int, first: int) -> FloatArray:
    """Σ_l w_l x(k − first − l), shape (plants,), of signals from rest."""
    stop = k + 1 - first
    used = min(len(weights), max(stop, 0))
    return np.asarray(values[:, stop - used : stop][:, ::-1] @ weights[:used])


# steps are followed for so many of the longest promised settling times
_FOLLOWED = 3.0
# plants that are drawn at first, by which factor more while they do not tell, and at most
_FIRST_PLANTS, _MORE_PLANTS, _MOST_PLANTS = 200, 4, 3200
SHARE = 0.95


@dataclass(frozen=True, eq=False)
class DecoupledLoop:
    """One output's loop: its nominal plant Λ_i, and weights W_ij of its uncertainty and
    interactions, `proven` or not.
    """

    output: str
    plant: TransferFunction
    weights: tuple[TransferFunction, ...]
    proven: bool
    loop: Loop

    @cached_property
    def magnitude(self) -> FloatArray:
        """Σ_j |W_ij| on the loop's grid."""
        return self.summed(self.loop.omega)

    def summed(self, omega: FloatArray) -> FloatArray:
        """Σ_j |W_ij(ω)|."""
        return np.asarray(sum(np.abs(weight.frequency_response(omega)) for weight in self.weights))

    @property
    def crossing(self) -> float:
        """Where it reaches 1 [rad/s]."""
        try:
            return critical_frequency(self.loop.omega, self.magnitude)
        except BadInput:
            raise BadInput(
                f"control of {self.output!r}: interactions and uncertainty are"
                f" {100 * self.magnitude[0]:.0f} % of its own path at the lowest frequency;"
                " identify with more or better data, or control fewer outputs"
            ) from None

    def stability_bound(self, controller: TransferFunction) -> float:
        """max_ω |T_i| Σ_j |W_ij| on a grid 20 times finer."""
        fine = self.loop.finer[0]
        L = fine.G[0] * controller.frequency_response(fine.omega)
        return float(np.max(np.abs(L / (1.0 + L)) * self.summed(fine.omega)))


@dataclass(frozen=True, eq=False)
class MultivariableDesign:
    """Decoupler D, a designed controller an output, and max_ω |T_i| Σ_j |W_ij| of each: below 1 all
    loops are stable together.
    """

    decoupler: FloatArray
    loops: tuple[DecoupledLoop, ...]
    points: tuple[Point[Synthesis], ...]
    bounds: tuple[float, ...]

    @property
    def controllers(self) -> tuple[TransferFunction, ...]:
        """C_i(z), from the control error of output i to the decoupler's input i."""
        return tuple(point.design.controller for point in self.points)

    @property
    def certified(self) -> bool:
        """Whether every drawn model's closed loop is proven stable."""
        return (
            all(loop.proven for loop in self.loops)
            and max(self.bounds) < 1.0
            and all(p.design.stable for p in self.points)
        )


@dataclass(frozen=True, eq=False)
class MeasuredLoop:
    """An output when its own reference steps by 1, and the largest |other output| then, of the
    nominal and of drawn plants.
    """

    own: Measured
    coupling: float
    drawn_coupling: FloatArray


class MultivariableProblem:
    """The decoupled plant and its loops.

    Parameters
    ----------
    model : MultivariableModel
        As many outputs as inputs, two or more.
    seed : int
        Of the random plants.
    choice : WeightChoice or None
        ε, ζ, rule, order and grid of the weights.

    Raises
    ------
    BadInput
        Not square, a path without delay, static gains that cannot be inverted.
    """

    def __init__(
        self, model: MultivariableModel, seed: int = 0, choice: WeightChoice | None = None
    ) -> None:
        self.model, self.seed, self.choice = model, seed, choice or WeightChoice()
        p, q = len(model.outputs), len(model.inputs)
        if p != q or p < 2:
            raise BadInput(
                f"multivariable control: the model has {q} inputs and {p} outputs; needs as many of"
                " both, at least two"
            )
        # The loop would be algebraic: any gain looks stable in one, and diverges on the plant.
        if any(path.delay < 1 for row in model.models for path in row):
            raise BadInput(
                "multivariable control: a path acts within its sample; identify it with delay 1 or"
                " more"
            )
        self.sample_time = model.models[0][0].sample_time
        gains = model.frequency_response([0.0])[0].real
        if np.linalg.matrix_rank(gains, tol=1e-9 * float(np.abs(gains).max(initial=1e-300))) < p:
            raise BadInput(
                "multivariable control: the static gains are singular; two outputs move as one"
            )
        self.gains, self.decoupler = gains, np.linalg.inv(gains)
        self.nominal = self._taps(
            np.array([[path.impulse_response for path in row] for row in model.models])[None]
        )

    @property
    def relative_gains(self) -> FloatArray:
        """Relative gain array (rows: outputs); entries far from 0 and 1 mean that decoupling rests
        on small differences.
        """
        return np.asarray(self.gains * self.decoupler.T)

    def _taps(self, g: FloatArray) -> FloatArray:
        """Impulse responses from lag 0 on, shape (plants, p, q, length)."""
        late = np.array([[path.delay for path in row] for row in self.model.models])
        taps = np.zeros((*g.shape[:3], int(late.max()) + g.shape[3]))
        for i, j in np.ndindex(late.shape):
            taps[:, i, j, late[i, j] : late[i, j] + g.shape[3]] = g[:, i, j]
        return taps

    def drawn(self, count: int, stream: int) -> FloatArray:
        """Random plants, shape (count, p, q, length); another `stream`, others. As long as the data
        can tell.
        """
        return self._taps(
            # Streams of their own: what is measured on has not been designed for.
            self.model.sample_longer(count, np.random.default_rng([self.seed, stream]))
        )

    def _nominal_and(self, drawn: FloatArray) -> FloatArray:
        """The nominal plant, its response ended by zeros, before the others."""
        ended = np.pad(
            self.nominal, ((0, 0), (0, 0), (0, 0), (0, drawn.shape[3] - self.nominal.shape[3]))
        )
        return np.concatenate([ended, drawn])

    @cached_property
    def loops(self) -> tuple[DecoupledLoop, ...]:
        """The loops with their weights."""
        plants = self._nominal_and(self.drawn(self.choice.samples, 0))
        decoupled = np.einsum("npqm,qr->nprm", plants, self.decoupler)
        return tuple(self._loop(i, decoupled) for i in range(len(self.gains)))

    @one_thread_if_small(LARGEST_FOR_ONE_THREAD)
    def _loop(self, i: int, decoupled: FloatArray) -> DecoupledLoop:
        own = decoupled[0, i, i]
        taps = np.trim_zeros(own, "f")
        plant = TransferFunction(taps, np.r_[1.0, np.zeros(len(own) - 1)], self.sample_time)
        omega = frequency_grid([plant], points=self.choice.points, lowest=self.choice.lowest)
        weights, proven = [], True
        for j in range(decoupled.shape[2]):
            difference = decoupled[:, i, j] - (own if i == j else 0.0)
            errors = DrawnErrors(difference, own[None], self.sample_time, "multiplicative")
            grid, largest = refined_grid(
                errors.envelope, plant.frequency_response, errors.lags, self.sample_time, omega
            )
            weight, sure = weight_above(errors, grid, largest, self.choice.weight_order)
            weights.append(weight)
            proven &= sure
        return DecoupledLoop(
            self.model.outputs[i], plant, tuple(weights), proven, Loop([plant], omega)
        )

    def solve(self, law: ControllerStructure, wishes: Wishes) -> MultivariableDesign:
        """Algorithm 2 in each loop, with (1 + γ) Σ_j |W_ij| in the place of |W_T|, so that the
        slack γ costs no stability.

        Raises
        ------
        Infeasible
            No controller of the structure meets the aim in a loop; says which loop, constraint and
            by how much.
        BadInput
            Wishes other than those of the nominal aim by weights; a loop that is too uncertain at
            the lowest frequency.
        """
        if wishes.aim != "nominal" or wishes.in_time:
            raise BadInput(
                "multivariable control: has the nominal aim alone, by weights; leave in_time out"
            )
        longest = wishes.settling_time or 10.0 * self.nominal.shape[3] * self.sample_time
        aim = NominalAim(wishes.overshoot, longest, wishes.slack, only=wishes.only)
        points = []
        for loop in self.loops:
            try:
                design = design_for_nominal_performance(
                    loop.loop, wishes.limit * loop.magnitude, law, aim, loop.crossing
                )
            except Infeasible as no:
                raise Infeasible(f"loop of {loop.output!r}: {no}") from None
            points.append(design.chosen)
        bounds = tuple(
            loop.stability_bound(point.design.controller)
            for loop, point in zip(self.loops, points, strict=True)
        )
        return MultivariableDesign(self.decoupler, self.loops, tuple(points), bounds)

    def measured(self, design: MultivariableDesign) -> tuple[MeasuredLoop, ...]:
        """Step responses of the whole, every reference in turn, of the nominal plant and of plants
        that no design has seen.
        """
        longest = max(point.second for point in design.points)
        n = max(round(_FOLLOWED * longest / self.sample_time), 4 * self.nominal.shape[3])
        count = _FIRST_PLANTS
        while True:
            plants = self._nominal_and(self.drawn(count, 1))
            loops = tuple(self._seen(design, plants, i, n) for i in range(len(self.gains)))
            if count >= _MOST_PLANTS or all(
                loop.own.is_sure_of(SHARE, self.sample_time) for loop in loops
            ):
                return loops
            count *= _MORE_PLANTS

    def _seen(
        self, design: MultivariableDesign, plants: FloatArray, i: int, n: int
    ) -> MeasuredLoop:
        y = closed_loop_steps(plants, design.decoupler, design.controllers, i, n)
        nominal, *drawn = [assess(response, self.sample_time) for response in y[:, :, i]]
        coupling = np.abs(np.delete(y, i, axis=2)).max(axis=(1, 2))
        coupling = np.where(np.isfinite(coupling), coupling, math.inf)
        return MeasuredLoop(Measured(nominal, tuple(drawn)), float(coupling[0]), coupling[1:])


def reached(values: Sequence[float] | FloatArray) -> float:
    """What 95 % of the values stay below."""
    return float(np.quantile(values, SHARE, method="higher"))
