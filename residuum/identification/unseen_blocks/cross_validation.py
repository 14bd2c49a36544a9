"""Errors on unseen blocks: one fit to everything, and from there a simulated step to the fit
without each fold of blocks.

What the equations of the one fit say of the values without a fold is off up to ten times where a
value is nearly undetermined, or the model far from linear in it; one step, shortened until the rest
is fitted no worse and simulated, is right within a few per cent, for the price of a pass a fold.
Its damping refuses what only fits: a value that the rest leaves nearly undetermined would go
anywhere.

Further terms (the free term) follow in closed form: with the errors e of the fit, their slopes T by
the parameters (first states projected out window by window) and H_b = T_bᵀT_b, g_b = T_bᵀe_b of
each block b, the fit without a fold of blocks moves by

    δθ = (Σ H_rest + d·diag Σ H)⁻¹ Σ g_rest,    e_out → e_out − T_out δθ.

References
----------
R. D. Cook, S. Weisberg, *Residuals and Influence in Regression*, 1982, ch. 2 (deletion); A.
Vehtari, A. Gelman, J. Gabry, Stat. Comput. 27 (2017) 1413 (paired differences on data kept aside).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.physics import Key, PhysicalModel
from residuum.identification.physics.estimation.coloured_covariance import coloured_covariance
from residuum.identification.physics.estimation.gauss_newton import Fit
from residuum.identification.physics.estimation.least_squares import solve_scaled
from residuum.identification.unseen_blocks.policy import DAMPING, LONG_RECORDS, QUICKLY_FITTED
from residuum.identification.unseen_blocks.structure import Structure, at_start, fitted

if TYPE_CHECKING:
    from residuum.identification.unseen_blocks.data import Data, Horizon
    from residuum.identification.unseen_blocks.scale import Scale

Integers = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class ValidatedFit:
    """A structure and its errors on blocks that it has not seen.

    Attributes
    ----------
    structure : Structure
    parameters : float
        How many its effects have that are estimated, for how many more these count as they are
        rare, and how many first states of the model's own are felt: those stay fitted to the blocks
        that are left out.
    power : array, shape (blocks, measured outputs)
        Sums of squares in the scale, clipped.
    left : array, shape (rows, measured outputs)
        The errors in the scale, clipped; 0 where nothing was measured.
    cost : float
        Of power; `seen_cost` the same on the blocks that the fit has seen.
    squares, count : arrays, shape (blocks, outputs)
        Sums of squares in the outputs' units, and of how many samples.
    errors : array, shape (rows, outputs)
        Of the fit itself, in the outputs' units; NaN where nothing was measured.
    """

    structure: Structure
    parameters: float
    power: FloatArray
    left: FloatArray
    cost: float
    seen_cost: float
    squares: FloatArray
    count: FloatArray
    errors: FloatArray

    @property
    def keys(self) -> tuple[Key, ...]:
        """The effects."""
        return self.structure.keys

    @property
    def model(self) -> PhysicalModel:
        """With the values fitted to everything."""
        return self.structure.model

    @property
    def rarity(self) -> float:
        """For how many of the parameters the effects count besides their own."""
        return self.structure.rarity

    @property
    def rms(self) -> FloatArray:
        """Error of each output on unseen blocks; NaN where it was not measured, shape
        (outputs,).
        """
        count = self.count.sum(axis=0)
        return np.sqrt(
            np.divide(
                self.squares.sum(axis=0), count, out=np.full(len(count), np.nan), where=count > 0
            )
        )


@dataclass(frozen=True, eq=False)
class Equations:
    """Errors (rows, measured outputs) of a fit in a scale, their slopes by parameters with first
    states projected out, those by first `states`, and the values with their bounds; `huber` weighs
    what is clipped, windows begin at `starts`.
    """

    errors: FloatArray
    known: npt.NDArray[np.bool_]
    slopes: FloatArray
    states: FloatArray
    huber: FloatArray
    theta: FloatArray
    lower: FloatArray
    upper: FloatArray
    starts: tuple[int, ...]

    def beside_states(self, columns: FloatArray) -> FloatArray:
        """Columns (rows, outputs, m) of weighted slopes with what first states can do projected
        out, window by window.
        """
        out = columns * self.huber[..., None]
        if not (self.states.shape[2] and out.shape[2]):
            return out
        # t − X (XᵀX)⁻¹Xᵀ t: each window's first states are fitted to it alone, so what they can do
        # tells nothing of a value
        for begin, end in pairwise(self.starts):
            X = self.states[begin:end].reshape(-1, self.states.shape[2])
            T = out[begin:end].reshape(-1, out.shape[2])
            projected = T - X @ solve_scaled(X.T @ X, X.T @ T, 1e-12)
            out[begin:end] = projected.reshape(out[begin:end].shape)
        return out

    def step(self, extra: FloatArray) -> FloatArray:
        """The least squares values of further terms, whose slopes beside first states are `extra`,
        fitted to everything.
        """
        T = np.concatenate([self.slopes, extra], axis=2)
        H = np.einsum("roi,roj->ij", T, T)
        g = np.einsum("roi,ro->i", T, self.errors * self.huber)
        return np.asarray(
            solve_scaled(H + DAMPING * np.diag(np.diag(H)), g[:, None], 1e-10)[
                self.slopes.shape[2] :, 0
            ]
        )

    def unseen(
        self, block: Integers, fold: Integers, extra: FloatArray | None = None
    ) -> FloatArray:
        """The errors of each row, the fold of its block left out of the fit; `extra` are slopes of
        further terms beside first states.
        """
        T, theta, lower, upper = self.slopes, self.theta, self.lower, self.upper
        if extra is not None:  # further terms begin at zero and have no bounds
            T = np.concatenate([T, extra], axis=2)
            count = extra.shape[2]
            theta = np.append(theta, np.zeros(count))
            lower = np.append(lower, np.full(count, -np.inf))
            upper = np.append(upper, np.full(count, np.inf))
        if not T.shape[2]:
            return self.errors.copy()
        row_fold, left = fold[block], self.errors.copy()
        for k, step in moved(T, self.errors * self.huber, row_fold).items():
            rows = row_fold == k
            # a step beyond a bound would be one that no fit may take
            taken = np.clip(theta + step, lower, upper) - theta
            # T is weighed by √w for the normal equations; the error itself moves by the plain slope
            left[rows] -= (T[rows] / self.huber[rows][..., None]) @ taken
        return left


def moved(T: FloatArray, e: FloatArray, row_fold: Integers) -> dict[int, FloatArray]:
    """How far the values move where a fold of rows is left out, (q,) a fold. It follows from
    weighted slopes T (rows, outputs, q) and errors e (rows, outputs) of the fit to everything.
    """
    H, g = normal_equations(T, e, row_fold)
    return dict(zip(np.unique(row_fold).tolist(), steps_without(H, g, DAMPING), strict=True))


def normal_equations(
    T: FloatArray, e: FloatArray, row_fold: Integers
) -> tuple[FloatArray, FloatArray]:
    """TᵀT (folds, q, q) and Tᵀe (folds, q) of slopes T (rows, outputs, q) and errors e (rows,
    outputs), by fold of rows.
    """
    by_fold = [(T[at], e[at]) for at in (row_fold == k for k in np.unique(row_fold))]
    H = np.array([np.einsum("roi,roj->ij", t, t) for t, _ in by_fold])
    return H, np.array([np.einsum("roi,ro->i", t, r) for t, r in by_fold])


def steps_without(H: FloatArray, g: FloatArray, damping: float) -> list[FloatArray]:
    """The step to the values that the other folds ask for, of each fold; `damping` of the curvature
    of all.
    """
    all_H, all_g = H.sum(axis=0), g.sum(axis=0)
    # of the curvature of all folds, so that a fold which alone tells a value is not left without
    # any
    ridge = damping * np.diag(np.diag(all_H))
    return [
        solve_scaled(all_H - h + ridge, (all_g - b)[:, None], 1e-10)[:, 0]
        for h, b in zip(H, g, strict=True)
    ]


def equations(fit: Fit, horizon: Horizon, scale: Scale) -> Equations | None:
    """Errors and slopes of a fit; None where it diverges."""
    simulator, model = fit.problem.simulator, fit.model
    names, free_states = list(model.free), [f"initial:{name}" for name in simulator.free_states]
    columns = [*names, *free_states]
    runs = simulator.run_each(
        horizon.parts, fit.initial, fit.problem.p(fit.theta), slopes=columns, substeps=fit.substeps
    )
    if not runs.bounded:
        return None
    starts, measured = horizon.starts.tolist(), scale.weights > 0.0
    known = np.isfinite(runs.errors)
    # a missing sample counts as no error before the filter, which would spread NaN, and after it
    weighted_errors = np.where(known, runs.errors, 0.0) * scale.weights
    R = scale.whitened(weighted_errors, starts)[:, measured]
    dY = np.zeros((*runs.errors.shape, 0)) if runs.dY is None else runs.dY
    weighted_slopes = np.where(known[..., None], dY, 0.0) * scale.weights[:, None]
    J = scale.whitened(weighted_slopes, starts)[:, measured]
    known = known[:, measured]
    R[~known], J[~known] = 0.0, 0.0
    # Huber's weights √w, w = c/|e| beyond the clip c: iteratively reweighted least squares
    clip = np.maximum(scale.clip[measured], 1e-300)
    huber = np.sqrt(clip / np.maximum(np.abs(R), clip))
    J *= huber[..., None]
    values = [model.all_parameters[name] for name in names]
    theta = np.array([p.value for p in values])
    lower = np.array([p.lower for p in values])
    upper = np.array([p.upper for p in values])
    T, X = J[..., : len(names)] / huber[..., None], J[..., len(names) :]
    # a value at its bound stays there: it is none of those that move with a fold
    T[..., (theta <= lower) | (theta >= upper)] = 0.0
    fit_equations = Equations(R, known, T, X, huber, theta, lower, upper, tuple(starts))
    return replace(fit_equations, slopes=fit_equations.beside_states(T))


def validated(
    structure: Structure, fit: Fit, horizon: Horizon, data: Data, scale: Scale, *, steps: int = 1
) -> ValidatedFit | None:
    """The structure's errors on unseen blocks, from its fit on a horizon in that scale; None where
    it diverges.

    So many steps to the values without each fold are simulated.
    """
    measured, starts = scale.weights > 0.0, horizon.starts.tolist()
    row_fold, cell_fold = data.fold[horizon.block], data.fold[horizon.cells.block]
    errors = np.concatenate(fit.residuals)
    known = np.isfinite(errors)[:, measured]

    def in_scale(rows: FloatArray) -> FloatArray:
        white = scale.whitened(np.nan_to_num(rows) * scale.weights, starts)[:, measured]
        return np.where(known, np.clip(white, -scale.clip[measured], scale.clip[measured]), 0.0)

    # of each fold only the rows that its fit has not seen
    unseen, left = errors.copy(), np.zeros(known.shape)
    for fold in np.unique(cell_fold).tolist():
        rows = row_fold == fold
        fold_fit = fit.without(cell_fold == fold, DAMPING, steps)
        fold_errors = np.concatenate(fold_fit.residuals)
        # filtered as a whole and cut then: the filter's past lies in blocks before it
        unseen[rows], left[rows] = fold_errors[rows], in_scale(fold_errors)[rows]
    power = summed(left**2, horizon, data.blocks)
    seen_power = summed(in_scale(errors) ** 2, horizon, data.blocks)
    if not np.all(np.isfinite(power)):
        return None
    model = structure.model
    parameters = structure.rarity + sum(not p.fixed for p in model.parameters.values())
    parameters += sum(not p.fixed for use in model.effects for p in use.parameters.values())
    # of a position that no output tells each record has its own: with an effect of it each record
    # would have a load of its own for nothing
    parameters += fit.felt
    # once more in the outputs' units and unclipped: what a user is told
    squares, count = np.zeros((2, data.blocks, len(measured)))
    plain_errors = np.where(known, np.nan_to_num(unseen[:, measured]), 0.0)
    squares[:, measured] = summed(plain_errors**2, horizon, data.blocks)
    count[:, measured] = summed(known.astype(float), horizon, data.blocks)
    cost, seen_cost = scale.cost(power, parameters), scale.cost(seen_power, parameters)
    return ValidatedFit(structure, parameters, power, left, cost, seen_cost, squares, count, errors)


def summed(values: FloatArray, horizon: Horizon, blocks: int) -> FloatArray:
    """Sums over the rows of each block, shape (blocks, columns)."""
    return np.column_stack(
        [np.bincount(horizon.block, weights=column, minlength=blocks) for column in values.T]
    )


# What the structures of a level are fitted to and judged by.

SHORT, LONG = "short", "long"
"""Kinds of quick fits: on a few short windows, on the horizon of the validation. Friction in a long
oscillation shows on the whole record only, and there a wrong phase hides everything else.
"""


@dataclass(frozen=True, eq=False)
class CrossValidation:
    """What all structures of a level are validated by: the data, the `last` horizon, on which they
    are fitted and judged, the `middle` one of quick fits on short windows, the scale of errors, and
    what the model as it is leaves in each window of the middle one (`window_errors`, mean squares;
    None: not known).
    """

    data: Data
    last: Horizon
    middle: Horizon
    scale: Scale
    window_errors: FloatArray | None = None

    @cached_property
    def _short(self) -> tuple[Horizon, Sequence[int]]:
        return self.middle.thinned(QUICKLY_FITTED, self.window_errors)

    def windows_of(self, kind: str) -> tuple[Horizon, Sequence[int]]:
        """What a quick fit of a kind sees, and which windows of its horizon those are."""
        return (self.last, range(len(self.last.parts))) if kind == LONG else self._short

    @property
    def kinds(self) -> tuple[str, ...]:
        """The quick fits that there are: long records are fitted quickly in short windows alone."""
        if self.middle is self.last:
            return (LONG,)
        is_long = self.last.starts[-1] > LONG_RECORDS
        return (SHORT,) if is_long else (LONG, SHORT)

    def validate(
        self, structure: Structure, *, steps: int, tolerance: float
    ) -> ValidatedFit | None:
        """The structure fitted on the last horizon, and judged there; None where it diverges."""
        windows = self.last.windows
        fit = fitted(
            structure.model,
            self.last,
            structure.states.get(windows),
            self.scale,
            steps=steps,
            tolerance=tolerance,
            substeps=structure.steps.get(windows),
        )
        return None if fit is None else self.validate_fit(structure, fit)

    def begun(self, structure: Structure, model: PhysicalModel | None = None) -> Fit | None:
        """A structure that was found on the last horizon, or a model that has more than it, at its
        own values there; None where that diverges.
        """
        states, steps = structure.states[self.last.windows], structure.steps[self.last.windows]
        return at_start(model or structure.model, self.last, states, self.scale, steps)

    def validate_fit(self, structure: Structure, fit: Fit) -> ValidatedFit | None:
        """The structure judged by a fit on the last horizon."""
        return validated(structure.at(self.last, fit), fit, self.last, self.data, self.scale)

    def doubts(self, structure: Structure) -> dict[str, float]:
        """Standard deviations of a structure's parameters by full name, in noise of the colour that
        it leaves; none where it diverges.
        """
        fit = self.begun(structure)
        if fit is None:
            return {}
        # a rival that hardly holds together has slopes beyond all numbers: then nothing is known
        with np.errstate(over="ignore", invalid="ignore"):
            variances = np.diag(coloured_covariance(fit, self.last.parts))
        known = np.where(np.isfinite(variances), np.maximum(variances, 0.0), np.inf)
        return dict(zip(fit.parameters, np.sqrt(known).tolist(), strict=True))
