"""Size of the innovations of a healthy residual, freed of what the identified model took from, or added to, these samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce
from operator import add

import numpy as np
from scipy import optimize, stats

from residuum.array_types import FloatArray
from residuum.diagnosis.residuals.noise_model import GAUSSIAN_SHAPE, STEEPEST, NoiseModel
from residuum.identification.errors import NotIdentifiable
from residuum.identification.kernel_based.gram import RegressionSums, regression_sums
from residuum.identification.linear_models.identified_model import IdentifiedModel

_NEGLIGIBLE = 1e-10  # of the largest eigenvalue: directions that the input does not excite
_BINS, _NODES = 300, 60  # of the residual's histogram, and of the Gauss–Hermite rule
_MOST = 4  # samples at least for each direction that is fitted


def with_unbiased_size(
    noise: NoiseModel, inputs: Sequence[FloatArray], residuals: Sequence[FloatArray], model: IdentifiedModel
) -> NoiseModel:
    """The noise model with σ corrected for the model's error on these records, and with the degrees of freedom it rests on.

    On the records a model was identified from its residual is too small by the k directions it was fitted in, on others
    too large by its error: e = v − Φ δ with v correlated with δ, or not. What the best impulse response leaves over does
    not depend on δ, so

        σ̂² = min_δ ‖A (e − Φ δ)‖² / (n − k − p − 1)

    is unbiased for both, k being the directions of Φ that the input excites (the model's most uncertain ones, where there
    are more than n/4), p the order of A and 1 for the operating point. Heavier tails than Gaussian keep their shape; of lighter
    ones the shape is found anew without the model's error, which rounds off the bounds. The scale is corrected in the same
    proportion, and its degrees of freedom count by the Fisher information of a scale.

    Parameters
    ----------
    inputs, residuals : sequences of arrays, shape (n,)
        u less its mean and the primary residual of each record; NaN = missing or not valid.

    Without a stretch longer than the model's memory nothing is corrected.
    """
    try:
        sums = _sums(noise, inputs, residuals, model)
    except NotIdentifiable:
        return replace(noise, freedom=_scale_freedom(noise, float(noise.n)))
    centred = sums.centred()
    explained, k = _explained(centred, model, sums.rows // _MOST)
    left = centred.degrees_of_freedom - k - (len(noise.ar) - 1)
    power = (centred.energy - explained) / left
    size = float(np.sqrt(power / (sums.energy / sums.rows)))
    error = float(np.sqrt(np.sum(centred.gram * model.covariance) / sums.rows / power))
    sharp = replace(noise, shape=shape_without(error, noise, residuals)) if noise.shape > GAUSSIAN_SHAPE else noise
    unit = sharp.innovation_std / sharp.sigma
    sigma = size * noise.innovation_std / unit
    return replace(sharp, sigma=sigma, freedom=_scale_freedom(sharp, float(left)), blur=error * unit)


def shape_without(error: float, noise: NoiseModel, residuals: Sequence[FloatArray]) -> float:
    """β of the noise alone, by maximum likelihood, where the residual also carries a Gaussian model error `error` σ large."""
    white = np.concatenate([np.convolve(e, noise.ar)[: len(e)] for e in residuals])
    white = np.abs(white[np.isfinite(white)])
    counts, edges = np.histogram(white / np.sqrt(np.mean(white**2)), bins=_BINS)
    nodes, weights = np.polynomial.hermite_e.hermegauss(_NODES)
    at = 0.5 * (edges[1:] + edges[:-1])[:, None] - error * nodes

    def cost(shape: float) -> float:
        law = stats.gennorm(shape)
        scale = float(np.sqrt(max(1.0 - error**2, _NEGLIGIBLE))) / float(law.std())
        density = law.pdf(at / scale) @ weights / scale
        return -float(counts @ np.log(np.maximum(density, np.finfo(float).tiny)))

    return float(optimize.minimize_scalar(cost, bounds=(GAUSSIAN_SHAPE, STEEPEST), method="bounded").x)


def _sums(
    noise: NoiseModel, inputs: Sequence[FloatArray], residuals: Sequence[FloatArray], model: IdentifiedModel
) -> RegressionSums:
    """Sums of the regression of the whitened residual on the whitened input's lags, over all records."""
    whitened = [(np.convolve(u, noise.ar)[: len(u)], np.convolve(e, noise.ar)[: len(e)])
                for u, e in zip(inputs, residuals, strict=True)]  # fmt: skip
    parts = []
    for u, e in whitened:
        try:
            parts.append(regression_sums([u], e, model.order, model.delay))
        except NotIdentifiable:
            continue
    if not parts:
        raise NotIdentifiable("no record is longer than the model's memory")
    return reduce(add, parts)


def _explained(sums: RegressionSums, model: IdentifiedModel, most: int) -> tuple[float, int]:
    """Energy that an error of the impulse response in its `most` most uncertain directions explains; how many are excited."""
    _, vectors = np.linalg.eigh(model.covariance)
    basis = vectors[:, ::-1][:, : max(most, 1)]
    eigenvalues, directions = np.linalg.eigh(basis.T @ sums.gram @ basis)
    excited = eigenvalues > _NEGLIGIBLE * eigenvalues[-1]
    along = directions[:, excited].T @ (basis.T @ sums.cross)
    return float(np.sum(along**2 / eigenvalues[excited])), int(excited.sum())


def _scale_freedom(noise: NoiseModel, samples: float) -> float:
    """Gaussian samples that would tell σ as well: the Fisher information of ln σ is 2 for those, 2 ν/(ν + 3) and β for ours."""
    return samples * (noise.dof / (noise.dof + 3.0) if np.isfinite(noise.dof) else noise.shape / 2.0)
