"""Passive robustness: the plain residual against a threshold that follows the input."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import signal

from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.state_space import FloatArray
from residuum.identification.linear_models.transfer_function import TransferFunction


@dataclass(frozen=True, eq=False)
class AdaptiveThreshold:
    """τ(t) = κ (Σ_k |h_k| |u(t−k)|/√m + σ): a threshold selector for (1.71), h the impulse response of Ĝ₀ W_T.

    The first part is what the uncertainty can make of the input applied lately; κ sets the false-alarm rate on healthy data.
    """

    envelope: FloatArray
    sigma: float
    kappa: float = 1.0

    def level(self, u: npt.ArrayLike) -> FloatArray:
        """τ(t), shape (n,)."""
        spread = signal.lfilter(self.envelope, [1.0], np.abs(np.asarray(u, dtype=float)))
        return np.asarray(self.kappa * (spread / np.sqrt(len(self.envelope)) + self.sigma))


def adaptive_threshold(
    model: IdentifiedModel, W_T: TransferFunction, sigma: float
) -> AdaptiveThreshold:
    """The threshold selector of an identified model and its weight; `sigma` the noise's standard deviation [output unit]."""
    length = model.delay + model.order
    return AdaptiveThreshold(
        np.abs(W_T.simulate(model.simulate(np.eye(1, length)[0]) - model.offset)), sigma
    )
