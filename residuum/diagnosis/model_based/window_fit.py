"""A window fitted with one thing more free than the healthy model has.

Least squares of whitened simulation errors by Gauss-Newton steps; values that the hypothesis does
not name keep their healthy scatter as a prior, so that a change smaller than that is none. What a
fit costs, in nats:

    ½ Σ_b samples_b ln(whitened power_b + 0.05) + ½ (ν + k) ln(1 + t²/ν) + ½ sizes · ln(samples),

the error power in blocks b, what k other values pay to the prior (Student: their scatter is known
from ν windows), and the sizes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.linalg import toeplitz

from residuum.array_types import FloatArray
from residuum.diagnosis.model_based.policy import (
    EM_STEPS,
    EVIDENT,
    FIT_STEPS,
    NO_MERIT,
    RIDGES,
    SCREENING_STEPS,
    SETTLED,
)
from residuum.diagnosis.model_based.variant import Variant
from residuum.identification.errors import BadInput
from residuum.identification.physics import Experiment, PhysicalModel, Simulator
from residuum.identification.unseen_blocks.policy import BLOCKS, WHITENING

# What healthy simulation errors look like: one autoregression an output whitens them, so that
# errors can be weighed in nats.

Flags = npt.NDArray[np.bool_]
_CORRELATED = 0.05
"""Autocorrelation under which samples count as independent."""


@dataclass(frozen=True, eq=False)
class Whitening:
    """What healthy simulation errors of each output look like.

    Attributes
    ----------
    filters : array, shape (outputs, order + 1)
        1 − φ₁ z⁻¹ − …, order by Akaike's criterion, zero beyond it.
    sigma : array, shape (outputs,)
        RMS of whitened healthy errors.
    inflation : array, shape (outputs,)
        By which correlation that is left divides the number of samples.
    steps, most_steps : array, shape (outputs,)
        Half the mean square of steps from sample to sample, in sigma²: what is usual of their white
        part, and the most.
    """

    filters: FloatArray
    sigma: FloatArray
    inflation: FloatArray
    steps: FloatArray
    most_steps: FloatArray

    def white(self, values: FloatArray, known: Flags) -> FloatArray:
        """Values (n, outputs, …) whitened, over their healthy size; zero where nothing was
        measured.
        """
        out = np.empty(values.shape)
        for o, a in enumerate(self.filters):
            measured = known[:, o].reshape((-1,) + (1,) * (values.ndim - 2))
            x = np.where(measured, values[:, o], 0.0)
            y = x.copy()
            # the first samples of a window lack a past and stay as large as they are
            for lag in np.flatnonzero(a[1:]) + 1:
                y[lag:] += a[lag] * x[:-lag]
            out[:, o] = np.where(measured, y, 0.0) / self.sigma[o]
        return out

    @property
    def amplified(self) -> FloatArray:
        """By how much whitening multiplies the steps' power of white noise, in sigma², shape
        (outputs,).
        """
        steps = np.diff(self.filters, axis=1, prepend=0.0, append=0.0)
        return np.asarray(0.5 * np.sum(steps**2, axis=1) / self.sigma**2)

    @classmethod
    def plain(cls, sigma: FloatArray) -> Whitening:
        """The one that only divides by these sizes: nothing is known of errors but how large."""
        filters = np.zeros((len(sigma), WHITENING + 1))
        filters[:, 0] = 1.0
        return cls(filters, sigma, *np.ones((3, len(sigma))))

    @classmethod
    def of(cls, errors: Sequence[FloatArray]) -> Whitening:
        """Learned from the errors (n, outputs) of healthy windows; Yule-Walker equations."""
        outputs = errors[0].shape[1]
        whitening = cls.plain(np.ones(outputs))
        for o in range(outputs):
            x = [np.nan_to_num(r[:, o]) for r in errors]
            a = _autoregression(x)
            white = [np.convolve(y, a)[: len(y)] for y in x]
            # The variance of a mean of correlated samples is 1 + 2 Σ ρ times that of independent
            # ones. The sum ends where ρ is lost in its own noise.
            rho = _autocorrelation(white, min(map(len, white)))
            end = int(np.argmax(rho < _CORRELATED)) or len(rho)
            sigma = max(float(np.sqrt(np.mean(np.concatenate(white) ** 2))), 1e-300)
            steps = [float(np.mean(np.diff(y) ** 2)) / 2.0 / sigma**2 for y in white]
            whitening.filters[o, : len(a)], whitening.sigma[o] = a, sigma
            whitening.inflation[o] = 1.0 + 2.0 * float(rho[1:end].sum())
            whitening.steps[o] = np.mean(steps)
            # two standard deviations over healthy windows: what is louder is louder than usual
            whitening.most_steps[o] = np.mean(steps) + 2.0 * np.std(steps)
        return whitening


def _autoregression(x: Sequence[FloatArray]) -> FloatArray:
    """1, −φ₁, −φ₂, … of the order that Akaike's criterion chooses."""
    rho, n = _autocorrelation(x, WHITENING + 1), sum(map(len, x))
    best, a = np.inf, np.ones(1)
    for p in range(WHITENING + 1):
        phi = np.zeros(0)
        if p:
            # the ridge: a slow error has ρ near 1 at all lags, and the equations are all but
            # singular
            R = toeplitz(rho[:p]) + 1e-9 * np.eye(p)
            phi = np.linalg.solve(R, rho[1 : p + 1])
        innovation_variance = max(1.0 - float(phi @ rho[1 : p + 1]), 1e-12)
        aic = n * np.log(innovation_variance) + 2.0 * p
        if aic < best:
            best, a = aic, np.concatenate([[1.0], -phi])
    return a


def _autocorrelation(x: Sequence[FloatArray], lags: int) -> FloatArray:
    """ρ at lags 0 … lags − 1 over all windows; padded to twice the length, so that the end of a
    window does not meet its beginning.
    """
    power = [np.abs(np.fft.rfft(y, 2 * len(y))) ** 2 for y in x]
    total = np.sum([np.fft.irfft(spectrum)[:lags] for spectrum in power], axis=0)
    return np.asarray(total / max(float(total[0]), 1e-300))


# How values scatter from one healthy window to the next, and move with the kind of run.
# x_w = Bᵀφ_w + δ_w, δ_w ~ N(0, S), x̂_w ~ N(x_w, H_w⁻¹),
# a hierarchical normal model: φ are the features of the run, H_w is what the window by itself
# says. B (ridge) and S by expectation and maximisation; how far each value may depend on φ by the
# evidence of its ridge. Far from the runs seen the scatter widens.
# References: A. Gelman et al., Bayesian Data Analysis, 3rd ed. 2013, ch. 5 and 15; D. MacKay,
# Neural Computation 4 (1992) 415 (evidence).


@dataclass(frozen=True, eq=False)
class Scatter:
    """Mean and scatter of values.

    Attributes
    ----------
    B : array, shape (features, values)
    S : array, shape (values, values)
    M : array, shape (values, features, features)
        (FᵀF + ridge)⁻¹ of each value.
    freedom : float
        Windows that S is worth.
    """

    B: FloatArray
    S: FloatArray
    M: FloatArray
    freedom: float

    @classmethod
    def of(
        cls,
        F: FloatArray,
        x: FloatArray,
        information: Sequence[FloatArray] | None,
        floor: FloatArray,
    ) -> Scatter:
        """Learned from windows.

        Parameters
        ----------
        F : array, shape (windows, features)
        x : array, shape (windows, values)
        information : sequence of array, shape (values, values), or None
            Of each window on its values; None: they are known exactly.
        floor : array, shape (values,)
            Least standard deviation of each.
        """
        # A ridge is chosen by the evidence of the windows' values, which depend on the ridges
        # themselves: begun with the least dependence on the run, and gone through twice.
        ridges = np.full(x.shape[1], RIDGES[0])
        scatter, post = _fitted(F, x, information, floor, ridges)
        for _ in range(2):
            ridges = np.array(
                [_evident_ridge(F, y, least) for y, least in zip(post.T, floor, strict=True)]
            )
            scatter, post = _fitted(F, x, information, floor, ridges)
        return scatter

    def at(self, features: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean (values,) and covariance (values, values) of a further window."""
        widened = np.sqrt(1.0 + np.einsum("i,pij,j->p", features, self.M, features))
        return features @ self.B, self.S * np.outer(widened, widened)


def _fitted(
    F: FloatArray,
    x: FloatArray,
    information: Sequence[FloatArray] | None,
    floor: FloatArray,
    ridges: FloatArray,
) -> tuple[Scatter, FloatArray]:
    """The scatter with these ridges, and each window's values as it and the others tell them."""
    n, p = x.shape
    # the first feature is 1: its row of B is the mean, which is all but free
    penalties = [np.diag([1e-6] + [ridge] * (F.shape[1] - 1)) for ridge in ridges]
    M = np.array([np.linalg.inv(F.T @ F + penalty) for penalty in penalties])
    M = M.reshape(p, F.shape[1], F.shape[1])
    freedom = np.array([max(n - float(np.trace(F @ m @ F.T)), 2.0) for m in M])
    post, V = x, np.zeros((n, p, p))
    B, S = np.zeros((F.shape[1], p)), np.zeros((p, p))
    # Expectation: each window's values, from what it says and what the others lead to expect (mean
    # `post`, covariance V). Maximisation: B and S of these values.
    for _ in range(1 if information is None else EM_STEPS):
        B = np.einsum("pij,wj,wp->ip", M, F, post)
        d = post - F @ B
        S = d.T @ d / np.sqrt(np.outer(freedom, freedom)) + V.mean(axis=0) + np.diag(floor**2)
        if information is not None:
            P = np.linalg.inv(S)
            V = np.array([np.linalg.inv(P + h) for h in information])
            by_window = zip(V, F @ B, information, x, strict=True)
            post = np.array([v @ (P @ mean + h @ y) for v, mean, h, y in by_window]).reshape(n, p)
    # as they are loaded: the order decides the last digit
    B, S, M = (np.ascontiguousarray(x) for x in (B, S, M))
    return Scatter(B, S, M, float(freedom.min(initial=float(n)))), post


def _evident_ridge(F: FloatArray, y: FloatArray, floor: float) -> float:
    """The ridge under which the values of the windows are likeliest; less of it only where that is
    evident.
    """
    # ln p(y) of y ~ N(mean, s² K) with s integrated out: −½ ln |K| − (n/2) ln(rᵀ K⁻¹ r)
    best, chosen = -np.inf, RIDGES[0]
    r = (y - y.mean()) / max(float(y.std()), float(floor), 1e-300)
    for ridge in RIDGES:
        K = np.eye(len(y)) + F[:, 1:] @ F[:, 1:].T / ridge
        square = max(float(r @ np.linalg.solve(K, r)), 1e-12)
        evidence = -0.5 * float(np.linalg.slogdet(K)[1]) - 0.5 * len(y) * np.log(square)
        if evidence > best + EVIDENT:
            best, chosen = evidence, ridge
    return chosen


@dataclass(frozen=True, eq=False)
class Fit:
    """A variant fitted to a window.

    Attributes
    ----------
    values, own : array
        Values of the healthy model that the hypothesis does not name, and the sizes.
    power : array, shape (blocks, outputs)
        Mean square of whitened errors over the healthy one.
    prior_cost : float
        [nat] What the values paid to the prior.
    white, error : array, shape (n, outputs)
        Errors whitened, and in the outputs' units (NaN where nothing was measured).
    information : array
        Of (values, own, first states), the prior left out.
    initial : array
        First states.
    substeps : list of int
        Runge–Kutta steps a sample.
    """

    variant: Variant
    values: FloatArray
    own: FloatArray
    power: FloatArray
    prior_cost: float
    white: FloatArray
    error: FloatArray
    information: FloatArray
    initial: FloatArray
    substeps: list[int]
    onset: int = 0


class WindowFitter:
    """Fits variants of the healthy model to one window, and says what a fit costs.

    Parameters
    ----------
    model : PhysicalModel
        Healthy.
    window : Experiment
    mean, covariance : array, shapes (values,), (values, values)
        Of the model's free values in healthy windows of such a run.
    whitening : Whitening
    freedom : float
        ν, windows that the covariance is known from.
    """

    def __init__(
        self,
        model: PhysicalModel,
        window: Experiment,
        mean: FloatArray,
        covariance: FloatArray,
        whitening: Whitening,
        freedom: float,
    ) -> None:
        self.model, self.free, self.window = model, list(model.free), window
        self.mean, self.covariance = mean, covariance
        self.whitening, self.freedom = whitening, freedom
        self.known = np.isfinite(window.Y)
        self.count = self.known.sum(axis=0)
        # independent samples of each output; 0 where it was not measured, so that it costs nothing
        self.samples = np.maximum(self.count / whitening.inflation, 2.0) * (self.count > 0)
        self.block = np.arange(window.n) * BLOCKS // window.n

    def of(self, window: Experiment) -> WindowFitter:
        """What fits another window of such a run."""
        return WindowFitter(
            self.model, window, self.mean, self.covariance, self.whitening, self.freedom
        )

    def blocks(self, white: FloatArray) -> FloatArray:
        """Mean square in each block, shape (blocks, outputs); healthy (1) where nothing was
        measured.
        """
        square = np.where(self.known, white * white, 0.0)
        total = np.array([np.bincount(self.block, v, BLOCKS) for v in square.T]).T
        count = np.array([np.bincount(self.block, v, BLOCKS) for v in self.known.T]).T
        return np.where(count > 0, total / np.maximum(count, 1), 1.0)

    def steps(self, white: FloatArray) -> FloatArray:
        """Half the mean square of steps from sample to sample in the usual block, shape
        (outputs,).
        """
        steps = np.concatenate(
            [np.zeros((1, white.shape[1])), np.diff(white, axis=0) / np.sqrt(2.0)]
        )
        return np.asarray(np.median(self.blocks(steps), axis=0))

    def noise_growth(self, white: FloatArray) -> FloatArray:
        """By how much white noise has grown beyond the most that is usual, told by steps, shape
        (outputs,).
        """
        return np.sqrt(np.maximum(self.steps(white) / self.whitening.most_steps, 1.0))

    def block_costs(self, fit: Fit) -> FloatArray:
        """[nat] What each block costs, shape (blocks,)."""
        return np.asarray(0.5 * np.log(fit.power + NO_MERIT) @ self.samples / BLOCKS)

    def healthy_cost(self) -> float:
        """[nat] What a window costs whose errors are healthy."""
        return float(0.5 * np.log(1.0 + NO_MERIT) * self.samples.sum())

    def penalty(self, fit: Fit) -> float:
        """[nat] What the fit's values pay to the prior, and half a logarithm of the samples for each
        of its sizes.
        """
        return fit.prior_cost + 0.5 * (len(fit.own) + (fit.onset > 0)) * float(
            np.log(max(self.samples.sum(), 4.0))
        )

    def cost(self, fit: Fit) -> float:
        """[nat] What the fit costs: its error in all blocks and its penalty."""
        return float(self.block_costs(fit).sum()) + self.penalty(fit)

    def fit(
        self,
        variant: Variant,
        steps: int = FIT_STEPS,
        begin: Fit | None = None,
        beside: Fit | None = None,
    ) -> Fit | None:
        """The variant fitted in at most so many steps; None where it cannot be simulated.

        Parameters
        ----------
        begin : Fit or None
            Of the same variant: begun where it ended; None: at the variant's own values.
        beside : Fit or None
            Of another variant, whose first states are taken. Screening keeps its steps between
            samples too, where the variant adds no state that may be faster.
        """
        try:
            problem = _Problem(self, variant, begin, None if beside is None else beside.initial)
            if (
                beside is not None
                and steps <= SCREENING_STEPS
                and len(problem.x0) == len(beside.initial)
            ):
                problem.substeps = beside.substeps
            return problem.solved(steps)
        except (BadInput, np.linalg.LinAlgError):
            return None

    def states(self, fit: Fit) -> FloatArray:
        """States along a fit of the healthy model, shape (n, states)."""
        simulator = Simulator(self.model)
        p = simulator.p(dict(zip(self.free, fit.values.tolist(), strict=True)))
        return np.asarray(
            simulator.run_each([self.window], [fit.initial], p, substeps=fit.substeps).X
        )


class _Problem:
    """Unknowns z: other values, own parameters, first states, sizes of what is done to signals."""

    def __init__(
        self, fitter: WindowFitter, variant: Variant, begin: Fit | None, first: FloatArray | None
    ) -> None:
        self.fitter, self.variant = fitter, variant
        self.simulator, parameters = Simulator(variant.model), variant.model.all_parameters
        shared = [j for j, name in enumerate(fitter.free) if name not in variant.own]
        names = [*(fitter.free[j] for j in shared), *variant.own]
        states = [name for name in self.simulator.free_states if name not in fitter.window.known]
        self.k, self.q, self.nx = len(shared), len(names), len(states)
        self.mean = fitter.mean[shared]
        self.prior = _root_of_inverse(fitter.covariance[np.ix_(shared, shared)])
        self.at = [self.simulator.states.index(name) for name in states]
        self.columns = self.simulator.columns(names)
        self.slopes = [*names, *(f"initial:{name}" for name in states)]
        # states have no bounds, sizes of what is done to signals no upper ones
        unbounded, sizes = np.full(self.nx, np.inf), np.full(len(variant.sizes), np.inf)
        lower, upper = [parameters[n].lower for n in names], [parameters[n].upper for n in names]
        self.lower = np.concatenate([lower, -unbounded, variant.lower])
        self.upper = np.concatenate([upper, unbounded, sizes])
        self.x0 = begin.initial if begin else self._first_states(first)
        self.z = np.clip(np.concatenate(self._begun(begin)), self.lower, self.upper)
        self.substeps: list[int] = []

    def _begun(self, begin: Fit | None) -> list[FloatArray]:
        """First values of the unknowns: where a fit ended, else the healthy mean, the variant's own
        values and its sizes.
        """
        variant, x0 = self.variant, self.x0[self.at]
        if begin:
            m = len(variant.own)
            return [begin.values, begin.own[:m], x0, begin.own[m:]]
        parameters = variant.model.all_parameters
        own = np.array([parameters[name].value for name in variant.own])
        return [self.mean, own, x0, np.array(variant.sizes)]

    def solved(self, steps: int) -> Fit | None:
        """The fit after so many steps; None where the first values cannot be simulated."""
        at_z = self._errors(self.z)
        if at_z is None:
            return None
        z = self.z
        # twice: errors beyond the healthy size say less
        for _ in range(1 if steps <= SCREENING_STEPS else 2):
            z, at_z = self._descended(z, at_z, self._weights(at_z[0]), steps)
        return self._fit_at(z, at_z)

    def _descended(
        self,
        z: FloatArray,
        at_z: tuple[FloatArray, FloatArray, FloatArray],
        weights: FloatArray,
        steps: int,
    ) -> tuple[FloatArray, tuple[FloatArray, FloatArray, FloatArray]]:
        # Levenberg and Marquardt: the damping rises until a step lowers the cost, and falls after
        # one that did. Weights are held during a descent, or the cost would not be one function.
        damping, now = 1e-3, self._cost(z, at_z[0], weights)
        for _ in range(steps):
            J = (at_z[1] * weights[:, None]).reshape(-1, len(z))
            H, g = J.T @ J, J.T @ (at_z[0] * weights).ravel()
            H[: self.k, : self.k] += self.prior.T @ self.prior
            g[: self.k] -= self.prior.T @ self._scaled_deviation(z)
            for _ in range(6):
                trial = np.clip(
                    z + _bounded_step(H, g, z, self.lower, self.upper, damping),
                    self.lower,
                    self.upper,
                )
                at_trial = self._errors(trial)
                if at_trial is not None and self._cost(trial, at_trial[0], weights) < now:
                    break
                damping = max(damping, 1e-4) * 8.0
            else:
                return z, at_z  # no step lowers the cost any more
            assert at_trial is not None
            before, now = now, self._cost(trial, at_trial[0], weights)
            z, at_z, damping = trial, at_trial, damping / 10.0
            if now > before * (1.0 - SETTLED):
                break
        return z, at_z

    def _fit_at(self, z: FloatArray, at_z: tuple[FloatArray, FloatArray, FloatArray]) -> Fit | None:
        k, q, nx, variant, fitter = self.k, self.q, self.nx, self.variant, self.fitter
        J = (at_z[1] * self._weights(at_z[0])[:, None]).reshape(-1, len(z))
        # a fit tells its first states after its sizes: they are eliminated, never told
        order = [*range(q), *range(q + nx, len(z)), *range(q, q + nx)]
        x0 = self.x0.copy()
        x0[self.at] = z[q : q + nx]
        power = fitter.blocks(at_z[0])
        # a gain of the sensor multiplies its noise too: that much more of it is no error
        if variant.noise_gain is not None:
            power = power / np.clip(
                fitter.noise_growth(at_z[0]), 1.0, np.maximum(variant.noise_gain(z[q + nx :]), 1.0)
            )
        information = (J.T @ J)[np.ix_(order, order)]
        if not (np.all(np.isfinite(power)) and np.all(np.isfinite(information))):
            return None
        deviation, freedom = self._scaled_deviation(z), fitter.freedom
        # Student's −ln p but for a constant: the prior's scatter is known from ν windows
        prior_cost = 0.5 * (freedom + k) * float(np.log1p(deviation @ deviation / freedom))
        error = np.where(fitter.known, at_z[2], np.nan)
        own = np.concatenate([z[k:q], z[q + nx :]])
        return Fit(
            variant,
            z[:k],
            own,
            power,
            prior_cost,
            at_z[0],
            error,
            information,
            x0,
            self.substeps,
            variant.onset,
        )

    def _scaled_deviation(self, z: FloatArray) -> FloatArray:
        """Values less their healthy mean, in standard deviations that are independent of each
        other.
        """
        return np.asarray(self.prior @ (z[: self.k] - self.mean))

    def _cost(self, z: FloatArray, white: FloatArray, weights: FloatArray) -> float:
        deviation = self._scaled_deviation(z)
        return float(np.sum((white * weights) ** 2) + deviation @ deviation)

    def _weights(self, white: FloatArray) -> FloatArray:
        """Of each output: correlated samples count for fewer, and an output whose error is larger
        than when healthy counts for as much less.
        """
        rms = np.sqrt((white**2).sum(axis=0) / np.maximum(self.fitter.count, 1))
        return np.asarray(1.0 / np.sqrt(self.fitter.whitening.inflation) / np.maximum(rms, 1.0))

    def _simulated(
        self, z: FloatArray, slopes: Sequence[str]
    ) -> tuple[FloatArray, FloatArray | None] | None:
        q, nx, e = self.q, self.nx, self.fitter.window
        p, x = self.simulator.p(), self.x0.copy()
        p[self.columns], x[self.at] = z[:q], z[q : q + nx]
        if self.variant.inputs is not None:
            U = self.variant.inputs(e.U, z[q + nx :])
            e = replace(e, U=U, hold=np.concatenate([e.hold, np.ones(U.shape[1] - e.U.shape[1])]))
        # chosen once: a cost whose steps change with z is not smooth
        if not self.substeps:
            self.substeps = self.simulator.substeps_each([e], [x], p)
        run = self.simulator.run_each([e], [x], p, slopes=slopes, substeps=self.substeps)
        return (run.Y, run.dY) if run.bounded else None

    def _errors(self, z: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """Whitened errors, their falling slopes (n, outputs, unknowns), and errors as they are;
        None where it diverges.
        """
        e, known, white = self.fitter.window, self.fitter.known, self.fitter.whitening.white
        first, variant = self.q + self.nx, self.variant
        run = self._simulated(z, self.slopes)
        if run is None or run[1] is None:
            return None
        Y, dY = run[0], run[1]
        # what is done to readings is affine: its linear part acts on the slopes
        if variant.reading is not None:
            dY = (
                variant.reading(dY, z[first:])
                - variant.reading(np.zeros_like(Y), z[first:])[:, :, None]
            )
            Y = variant.reading(Y, z[first:])
        for j in range(first, len(z)):  # sizes of what is done to signals: by differences
            moved = z.copy()
            moved[j] += 1e-4 * max(abs(z[j]), 1.0)
            run_j = self._simulated(moved, ()) if variant.inputs is not None else run
            if run_j is None:
                return None
            read = run_j[0] if variant.reading is None else variant.reading(run_j[0], moved[first:])
            dY = np.concatenate([dY, ((read - Y) / (moved[j] - z[j]))[:, :, None]], axis=2)
        return white(e.Y - Y, known), white(dY, known), e.Y - Y

    def _first_states(self, first: FloatArray | None) -> FloatArray:
        """Those of another fit, else what was measured first."""
        e, simulator = self.fitter.window, self.simulator
        x0 = simulator.x0(e.known)
        if first is not None:
            x0[: len(first)] = first[: len(x0)]
            return x0
        for o, out in enumerate(simulator.model.outputs.values()):
            name = out.value.text
            if name in simulator.free_states and name not in e.known and self.fitter.count[o]:
                x0[simulator.states.index(name)] = e.Y[self.fitter.known[:, o], o][0]
        return x0


def _root_of_inverse(covariance: FloatArray) -> FloatArray:
    """R with RᵀR = covariance⁻¹, also where values of very unlike sizes are nearly tied to each
    other.
    """
    # scaled to correlations, so that the floor on eigenvalues means the same in any unit
    size = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(size, size))
    return np.asarray((vectors / np.sqrt(np.maximum(values, 1e-9))).T / size)


def _bounded_step(
    H: FloatArray,
    g: FloatArray,
    z: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    damping: float,
) -> FloatArray:
    """The damped step, unknowns at a bound that it would leave held."""
    # scaled to unit diagonal: unknowns of unlike units are damped alike
    scale, held = np.sqrt(np.maximum(np.diag(H), 1e-300)), np.zeros(len(z), dtype=bool)
    A = H / scale / scale[:, None] + (damping + 1e-10) * np.eye(len(z))
    while True:
        step, free = np.zeros(len(z)), ~held
        step[free] = np.linalg.solve(A[np.ix_(free, free)], (g / scale)[free]) / scale[free]
        # each round holds at least one more, so that it ends
        leaves = free & (((z <= lower) & (step < 0.0)) | ((z >= upper) & (step > 0.0)))
        if not leaves.any():
            return step
        held |= leaves


def information(fit: Fit, keep: int) -> FloatArray:
    """Information of a fit on its first `keep` unknowns, all others eliminated."""
    return _schur_complement(fit.information, keep)


def information_on_size(fit: Fit, covariance: FloatArray) -> float:
    """Information of a fit on its only size, beside values of this prior covariance, shape (values,
    values); 0 where they make up for it wholly.
    """
    k = len(fit.values)
    H = fit.information.copy()
    H[:k, :k] += np.linalg.inv(covariance)
    order = [k, *range(k), *range(k + 1, len(H))]
    return max(float(_schur_complement(H[np.ix_(order, order)], 1)[0, 0]), 0.0)


def _schur_complement(H: FloatArray, keep: int) -> FloatArray:
    """Schur's complement of all but the first `keep`."""
    A, B, C = H[:keep, :keep], H[:keep, keep:], H[keep:, keep:]
    if not len(C):
        return A
    # scaled to unit diagonal; directions of which nothing is known are left out, not inverted
    d = np.sqrt(np.maximum(np.diag(C), 1e-300))
    left = A - (B / d) @ np.linalg.pinv(C / d / d[:, None], rcond=1e-10, hermitian=True) @ (B / d).T
    return np.asarray(0.5 * (left + left.T))


def log_power(fit: Fit) -> FloatArray:
    """Logarithm of the RMS of errors as they are and whitened, shape (2 · outputs,)."""
    known = np.isfinite(fit.error)
    count = np.maximum(known.sum(axis=0), 1)
    rms = [
        np.sqrt((np.where(known, x, 0.0) ** 2).sum(axis=0) / count) for x in (fit.error, fit.white)
    ]
    return np.asarray(np.log(np.concatenate(rms) + 1e-300))
