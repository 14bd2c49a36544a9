"""What healthy samples say of the tails: of the whitened innovations, and of the robust residual a single sample is judged by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from residuum.array_types import FloatArray
from residuum.diagnosis.residuals.innovation_size import shape_without
from residuum.diagnosis.residuals.noise_model import GAUSSIAN_SHAPE, NoiseModel, fit_noise_model
from residuum.diagnosis.thresholds.tails import differing_tail


def with_healthy_tail(noise: NoiseModel, residuals: Sequence[FloatArray]) -> NoiseModel:
    """The noise model with a tail of its own where healthy samples contradict the form of its law.

    A model's error on its own records shrinks the innovations, on others it widens them: for lighter tails than exponential they
    are scaled to the power that new ones have, σ² and the model's error. To the samples of a linear fit this does what leaving
    each out of it does: its residual over 1 − h, h its leverage, here the mean one.

    Parameters
    ----------
    noise : NoiseModel
        With its size freed of the fit and its `blur`.
    residuals : sequence of arrays, shape (n,)
        Primary residual of each healthy record; NaN = missing or not valid.
    """
    bare = replace(noise, tail=None)
    white = np.concatenate([bare.whiten(e) for e in residuals])
    sizes = np.abs(white[np.isfinite(white)])
    if np.isinf(noise.dof):
        sizes *= float(np.hypot(noise.innovation_std / noise.sigma, noise.blur) / np.sqrt(np.mean(sizes**2)))
    return replace(noise, tail=differing_tail(sizes, lambda x: np.log(2.0) + bare.log_tail(x)))


def single_sample_law(residuals: Sequence[FloatArray], spread: float, errors: FloatArray) -> NoiseModel:
    """The law of the noise in one sample of a filtered residual, found on the residual itself; its `ar` is 1.

    A filter mixes many innovations into one sample, so that noise with bounds, or with heavy tails, comes out nearer to Gaussian.

    Parameters
    ----------
    residuals : sequence of arrays, shape (n,)
        Filtered residual of each healthy record; NaN = missing or not valid.
    spread : float
        Standard deviation of its noise, in its unit.
    errors : array, shape (samples,)
        Standard deviation of the model error in each of its samples, in its unit.

    Raises
    ------
    BadInput
        Fewer than 50 samples in a row, or residuals that do not vary.
    """
    law, error = fit_noise_model(residuals, highest_order=0), float(np.sqrt(np.mean(errors**2)))
    if np.isinf(law.dof):
        shape = shape_without(error / spread, law, residuals) if law.shape > GAUSSIAN_SHAPE else law.shape
        law = replace(law, shape=shape)
        law = replace(law, sigma=law.sigma * spread / law.innovation_std)
    return with_healthy_tail(replace(law, blur=error / law.sigma), residuals)
