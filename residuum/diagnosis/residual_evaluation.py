"""Residual evaluation: from residual signals to the statistic a threshold is held against."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from residuum.diagnosis.cusum import cusum
from residuum.diagnosis.likelihood_ratio import LikelihoodRatioBank
from residuum.diagnosis.residual_generator import ResidualSignals
from residuum.diagnosis.state_space import FloatArray
from residuum.identification.identified_model import IdentifiedModel

RMS_WINDOW = 50
CUSUM_REFERENCE = 0.5
_LAZY = 2.5  # below it the likelihood ratio need not know the model error exactly


def _point(model: IdentifiedModel, signals: ResidualSignals) -> FloatArray:
    return np.abs(signals.robust)


def _rms(model: IdentifiedModel, signals: ResidualSignals) -> FloatArray:
    return moving_rms(signals)


def _cusum(model: IdentifiedModel, signals: ResidualSignals) -> FloatArray:
    return cusum(signals.scores, signals.valid, CUSUM_REFERENCE, np.inf).statistic


def _glr(model: IdentifiedModel, signals: ResidualSignals) -> FloatArray:
    bank = LikelihoodRatioBank(1e-3, model.covariance, model.delay, threshold=_LAZY, restart=False)
    return bank.process(signals).statistic


EVALUATIONS: dict[str, Callable[[IdentifiedModel, ResidualSignals], FloatArray]] = {
    "point": _point,
    "rms": _rms,
    "cusum": _cusum,
    "glr": _glr,
}


def evaluate(name: str, model: IdentifiedModel, signals: ResidualSignals) -> FloatArray:
    """Undisturbed statistic (no restart after an alarm) of an evaluation, shape (n,), zero where the residual is not valid.

    `point` |r| [output unit × γ]; `rms` root mean square of 50 whitened scores; `cusum` two-sided CUSUM of the scores;
    `glr` generalised likelihood ratio of offset, gain and power over windows of 1 … 1024 samples.
    """
    return np.where(signals.valid, EVALUATIONS[name](model, signals), 0.0)


def moving_rms(signals: ResidualSignals, window: int = RMS_WINDOW) -> FloatArray:
    """√(mean of the last `window` squared scores), zero until that many valid ones in a row are there."""
    squares = np.where(signals.valid, signals.scores**2, 0.0)
    total = np.cumsum(np.concatenate([np.zeros(window), squares]))
    good = np.cumsum(np.concatenate([np.zeros(window), signals.valid]))
    full = good[window:] - good[:-window] == window
    mean = np.maximum(total[window:] - total[:-window], 0.0) / window
    return np.where(full, np.sqrt(mean), 0.0)
