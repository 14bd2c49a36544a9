"""How well a model simulates a record."""

from __future__ import annotations

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.errors import BadRecord
from residuum.identification.kernel_based.lagged_data import past_at_rest
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.integrating import from_straight_line
from residuum.identification.record import Record


def simulation_fit(model: IdentifiedModel, record: Record) -> float:
    """100 (1 − ‖y − ŷ‖/‖y − mean y‖) [%] of the simulation, over the samples whose whole past input is in the record.

    The level of ŷ is the one that fits best, since a constant offset belongs to the record, not to the model; of a model that
    integrates its straight line too, since the input at which the plant stands still does.

    Raises BadRecord when no sample has its whole past, or the output does not move.

    >>> model = IdentifiedModel(method="by hand", sample_time=1.0, impulse_response=[2.0], covariance=[[0.0]], noise_variance=0.0)
    >>> simulation_fit(model, Record({"u": [1.0, 0.0, 1.0, 0.0], "y": [5.0, 7.0, 5.0, 7.0]}, {"u": "", "y": ""}, 1.0))
    100.0
    """
    y, residual = simulated_beside(model, record)
    return float(100 * (1 - np.nanstd(residual) / np.nanstd(y)))


def simulated_beside(model: IdentifiedModel, record: Record, first: int = 0) -> tuple[FloatArray, FloatArray]:
    """y and y − ŷ from sample `first` on, shape (n − first,); NaN where the input's past is not whole.

    A past at rest is whole (`past_at_rest`). A model that is not stable shows its one-step predictions: its simulation tells of
    rounding alone.

    Raises BadRecord as `simulation_fit` does.
    """
    u, y = np.asarray(record[model.input_name], dtype=float), np.asarray(record[model.output_name], dtype=float)
    reach = model.delay + model.order - 1
    at_rest = past_at_rest([u], reach) > 0
    known = np.concatenate([np.full(reach, at_rest), ~np.isnan(u)])
    complete = np.lib.stride_tricks.sliding_window_view(known, reach + 1).all(axis=1) & ~np.isnan(y)
    level = float(np.nanmean(u)) if model.integrates and known.any() else float(u[0]) if at_rest else 0.0
    if model.diverges:
        residual = np.where(complete, y - _predicted(model, u, y, record.source or "record"), np.nan)[first:]
    else:
        residual = np.where(complete, y - model.simulate(np.where(np.isnan(u), 0.0, u - level)), np.nan)[first:]
    shown = np.where(complete, y, np.nan)[first:]
    if model.integrates:
        residual = from_straight_line(residual)
    spread = float(np.nanstd(shown)) if np.isfinite(shown).any() else 0.0
    if not spread > 0:
        where = record.source or "record"
        raise BadRecord(
            f"{where}: cannot be validated on: too few output samples have {reach} samples of input before them, "
            "or the output is constant"
        )
    return shown, residual


def _predicted(model: IdentifiedModel, u: FloatArray, y: FloatArray, where: str) -> FloatArray:
    if not (np.isfinite(u).all() and np.isfinite(y).all()):
        raise BadRecord(f"{where}: a model that is not stable is judged by its predictions, which need every sample")
    return model.predict(u, y)
