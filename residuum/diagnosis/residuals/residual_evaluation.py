"""Residual evaluation: from residual signals to the statistic a threshold is held against."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from residuum.array_types import FloatArray
from residuum.diagnosis.residuals.generators.residual_generator import ResidualSignals
from residuum.diagnosis.residuals.likelihood_ratio import LikelihoodRatioBank
from residuum.diagnosis.thresholds.false_alarm_rate import cusum

RMS_WINDOW = 50  # samples
CUSUM_REFERENCE = 0.5  # σ: half of the step of 1 σ that the sum finds soonest
_LAZY = 2.5  # below it the likelihood ratio need not know the model error exactly


class BankAt(Protocol):
    """Makes the likelihood-ratio bank of a design for a threshold."""

    def __call__(self, threshold: float, *, restart: bool = True) -> LikelihoodRatioBank:
        """The bank."""


EVALUATIONS: dict[str, Callable[[BankAt, ResidualSignals], FloatArray]] = {
    "point": lambda bank, signals: np.abs(signals.robust),
    "rms": lambda bank, signals: moving_rms(signals),
    "cusum": lambda bank, signals: (
        cusum(signals.scores, signals.valid, CUSUM_REFERENCE, np.inf).statistic
    ),
    "glr": lambda bank, signals: bank(_LAZY, restart=False).process(signals).statistic,
}


def evaluate(name: str, bank: BankAt, signals: ResidualSignals) -> FloatArray:
    """Undisturbed statistic (no restart after an alarm) of an evaluation, shape (n,), zero where
    the residual is not valid.

    `point` |r| [output unit × γ]; `rms` root mean square of 50 whitened scores; `cusum` two-sided
    CUSUM of the scores; `glr` generalised likelihood ratio of offset, gain and power over windows
    of 1 … 1024 samples, by the design's `bank`.
    """
    return np.where(signals.valid, EVALUATIONS[name](bank, signals), 0.0)


def moving_rms(signals: ResidualSignals, window: int = RMS_WINDOW) -> FloatArray:
    """√(mean of the last `window` squared scores), zero until that many valid ones in a row are
    there.
    """
    squares = np.where(signals.valid, signals.scores**2, 0.0)
    total = np.cumsum(np.concatenate([np.zeros(window), squares]))
    good = np.cumsum(np.concatenate([np.zeros(window), signals.valid]))
    full = good[window:] - good[:-window] == window
    mean = np.maximum(total[window:] - total[:-window], 0.0) / window
    return np.where(full, np.sqrt(mean), 0.0)
