"""Bands of single coefficients, with the hyper-parameters marginalised.

The prior's standard deviation decays exponentially along the lags, so a small error of the decay is
a large one of the band far out: at the estimated hyper-parameters 95 % bands hold 71 to 87 % of the
coefficients, and what a first-order term adds is little, for it moves the mean alone. Over their
posterior the variance is

    var g_k = E[var(g_k | η)] + var E[g_k | η],

which the slowest plausible decays rule far out. Search variables are drawn from Laplace's
approximation, widened so that these are among them, and weighted by the exact marginal likelihood.

Fails where no prior of one decay fits: of a fast mode with a weak slow one beside it, the bands
held 53 to 67 %.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.blas_threads import one_thread_if_small
from residuum.identification.kernel_based.marginal_likelihood import MarginalLikelihood
from residuum.identification.linear_models.identified_model import IdentifiedModel

COVERAGE = {
    "tc": "94 to 97",
    "dc": "94 to 98",
    "di": "94 to 96",
    "ss": "81 to 95 (81 where noise is as strong as signal)",
}
"""Measured share [%] within 1.96 standard deviations, variance ratios 1, 10, 100
(benchmarks/results/identification.md).
"""
WEAK_SLOW_MODE = {"tc": 67, "dc": 53, "di": 60, "ss": 57}
"""The same where a weak slow mode lies beside a fast one: the likelihood settles for the fast
decay, and rules the other out.
"""
MOST_COEFFICIENTS = 1000
"""Coefficients up to which bands are marginalised; beyond, sixty factorisations cost too much."""
# Pairs of draws; step of the differences of the gradient; standard deviation along a direction in
# which the likelihood is flat; by how much draws are spread further than Laplace's approximation,
# so that slow decays are among them.
_PAIRS, _STEP, _WIDEST, _WIDENED = 30, 1e-3, 2.0, 2.0
_FEWEST = 8.0  # effective draws; weights that leave fewer are flattened


class HyperMixture:
    """Posteriors of the coefficients at hyper-parameters drawn from their own posterior; computed
    when first asked for.

    Parameters
    ----------
    likelihood : MarginalLikelihood
    x : array
        Search variables of the largest marginal likelihood.
    scale : array, shape (p,)
        From the units of the sums to those of the coefficients.
    """

    def __init__(self, likelihood: MarginalLikelihood, x: FloatArray, scale: FloatArray) -> None:
        self._likelihood, self._x, self._scale = likelihood, x, scale

    @cached_property
    def std(self) -> FloatArray:
        """Root mean square of each coefficient about its estimate at `x`, shape (p,)."""
        with one_thread_if_small(len(self._scale)):
            points, log_density = self._proposals()
            estimate = self._likelihood.posterior(self._x).mean
            log_weight, squares = [], []
            for point, density in zip(points, log_density, strict=True):
                log_weight.append(-self._likelihood.value(point) - density)
                posterior = self._likelihood.posterior(point)
                squares.append(np.diag(posterior.covariance) + (posterior.mean - estimate) ** 2)
        return np.asarray(self._scale * np.sqrt(_weights(np.array(log_weight)) @ np.array(squares)))

    def _proposals(self) -> tuple[FloatArray, FloatArray]:
        """Search variables drawn from Laplace's approximation within their bounds, and ln of its
        density up to a constant.
        """
        x = self._x
        gradient = self._likelihood.value_and_gradient(x)[1]
        H = np.array(
            [
                (self._likelihood.value_and_gradient(x + e)[1] - gradient) / _STEP
                for e in _STEP * np.eye(len(x))
            ]
        )
        # Differences of a gradient are symmetric but for their step.
        curvature, axes = np.linalg.eigh(0.5 * (H + H.T))
        spread = 1.0 / np.sqrt(np.maximum(curvature, 0.0) + 1.0 / _WIDEST**2)
        # One seed: one record has one band. Each draw has its mirror image, and the estimate is one
        # of them.
        half = np.random.default_rng(1).standard_normal((_PAIRS, len(x)))
        z = np.vstack([np.zeros(len(x)), half, -half])
        points = x + _WIDENED * (z * spread) @ axes.T
        decay = [item.bounds for item in self._likelihood.kernel.parameters]
        # Decays have bounds; ln κ, the last variable of each input, has none.
        low, high = (
            np.tile([*(pair[k] for pair in decay), sign * np.inf], self._likelihood.n_inputs)
            for k, sign in ((0, -1), (1, 1))
        )
        return np.clip(points, low, high), -0.5 * np.square(z).sum(axis=1)


def band_says(model: IdentifiedModel) -> str | None:
    """What a 95 % band of single coefficients is known to cover; None for a model that no kernel
    made.
    """
    kernel = model.method.removeprefix("kernel-")
    if kernel not in COVERAGE:
        return None
    if model.pointwise_std is None and model.bands is None:
        return (
            "bands at the estimated hyper-parameters: 95 % ones hold 48 to 89 % of single"
            " coefficients where it was measured"
        )
    return (
        f"hyper-parameters marginalised: 95 % bands held {COVERAGE[kernel]} % of single"
        f" coefficients of random systems, but {WEAK_SLOW_MODE[kernel]} % where a weak slow mode"
        " lay beside a fast one"
    )


class PointwiseBands:
    """The part of a mixture that belongs to one impulse response."""

    def __init__(self, mixture: HyperMixture, part: slice) -> None:
        self._mixture, self._part = mixture, part

    @property
    def std(self) -> FloatArray:
        """Shape (m,)."""
        return self._mixture.std[self._part]


def _weights(log_weight: FloatArray) -> FloatArray:
    """Normalised weights, flattened until they leave enough effective draws."""
    power = 1.0
    while True:
        weight = np.exp(power * (log_weight - log_weight.max()))
        weight /= weight.sum()
        if 1.0 / float(np.square(weight).sum()) >= min(_FEWEST, 0.5 * len(weight)):
            return np.asarray(weight)
        power *= 0.7
