"""Step responses of a decoupled multivariable loop, of the nominal plant and of drawn ones, by difference equations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.linear_models.transfer_function import TransferFunction


def closed_loop_steps(
    taps: FloatArray, decoupler: FloatArray, controllers: Sequence[TransferFunction], reference: int, n: int
) -> FloatArray:
    """Outputs of u = D diag(C_i) (r − y) when one reference steps from 0 to 1, shape (plants, n, p).

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
    rows = taps[..., ::-1].reshape(count, p, q * length)  # oldest input first
    y, e, v = (np.zeros((count, p, n)) for _ in range(3))
    u = np.zeros((count, q, n + length - 1))
    laws = [_coefficients(controller) for controller in controllers]
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
    return np.r_[np.zeros(lag), controller.num] / controller.den[0], controller.den[1:] / controller.den[0]


def _recent(values: FloatArray, weights: FloatArray, k: int, first: int) -> FloatArray:
    """Σ_l w_l x(k − first − l), shape (plants,), of signals from rest."""
    stop = k + 1 - first
    used = min(len(weights), max(stop, 0))
    return np.asarray(values[:, stop - used : stop][:, ::-1] @ weights[:used])
