"""How a model fares on data that its fit has not seen, and how much of the input's effect it misses there.

The error r = y − ŷ of the simulation is regressed on the input: what that explains (adjusted R²) the model misses, what it does
not is noise, so that a poor fit of a noisy record is no fault of the model's.

    missing = R² var r / (var y − (1 − R²) var r)       part of the response's power

Fails where the data kept aside excite less than the others.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.blas_threads import one_thread_if_small
from residuum.identification.errors import BadRecord, NotIdentifiable
from residuum.identification.kernel_based.gram import regression_sums
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.plant_tests.long_autoregression import factored
from residuum.identification.linear_models.validation.fit import simulated_beside
from residuum.identification.linear_models.validation.residual_tests import input_correlation_test
from residuum.identification.record import Record

KEPT_ASIDE = 0.3
"""The last part of a record that no split note divides."""
_MOST_LAGS, _SAMPLES_A_LAG = 80, 12
_LEVEL, _TOO_MUCH = 1e-4, 0.1
_WORSE_THAN_A_CONSTANT = -5.0


@dataclass(frozen=True)
class KeptAside:
    """Of one part kept aside.

    Attributes
    ----------
    fit_percent : float
        100 (1 − ‖y − ŷ‖/‖y − mean y‖).
    missing : float
        Part of the response's power that the input explains and the model does not.
    p_value : float
        That the error is free of the input.
    """

    fit_percent: float
    missing: float
    p_value: float

    @property
    def fails(self) -> bool:
        """Worse than a constant, or more than a tenth of the response's power (a third of its size) is missing."""
        return self.fit_percent < _WORSE_THAN_A_CONSTANT or (self.missing > _TOO_MUCH and self.p_value < _LEVEL)


@one_thread_if_small(_MOST_LAGS)
def kept_aside(model: IdentifiedModel, record: Record, first: int = 0) -> KeptAside:
    """The model on the samples of `record` from `first` on; those before only give the input its past.

    Raises BadRecord for a part too short to have a fit, or one in whose past and present the input stands still.
    """
    seen = np.asarray(record[model.input_name], dtype=float)[max(first - model.delay - model.order + 1, 0) :]
    if first and not np.nanmax(seen) > np.nanmin(seen):
        raise BadRecord(
            f"{record.source or 'record'}: the input stands still in the part kept aside, which therefore tells nothing"
        )
    y, residual = simulated_beside(model, record, first)
    fit = 100 * (1 - float(np.nanstd(residual) / np.nanstd(y)))
    u = np.asarray(record[model.input_name], dtype=float)[first:]
    n = int(np.isfinite(residual).sum())
    lags = max(2, min(_MOST_LAGS, n // _SAMPLES_A_LAG))
    try:
        p_value = input_correlation_test(residual, u, lags=lags).p_value
    except NotIdentifiable:
        return KeptAside(fit, 0.0, 1.0)
    noise = float(np.nanvar(residual)) * (1 - _explained(residual, u, lags))
    response = float(np.nanvar(y)) - noise
    missing = (float(np.nanvar(residual)) - noise) / response if response > 0 else 0.0
    return KeptAside(fit, missing, p_value)


def _explained(residual: FloatArray, u: FloatArray, lags: int) -> float:
    """Adjusted R² of the residual on the last `lags` inputs, 0 at least."""
    try:
        sums = regression_sums([u], residual, lags, 0).centred()
    except NotIdentifiable:
        return 0.0
    if sums.rows <= 2 * lags or not sums.energy > 0:
        return 0.0
    _, explained = factored(sums)
    left = sums.energy - float(explained @ explained)
    return max(0.0, 1.0 - left / (sums.rows - lags - 1) / (sums.energy / (sums.rows - 1)))
