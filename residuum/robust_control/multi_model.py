"""Several operating points as one uncertain system: average model and overall weight (Algorithm 4)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.blas_threads import LARGEST_FOR_ONE_THREAD, one_thread_if_small
from residuum.identification.errors import BadInput
from residuum.identification.linear_models.error_bounds.drawn_errors import DrawnErrors
from residuum.identification.linear_models.error_bounds.error_grid import refined_grid
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.identification.linear_models.uncertainty import chernoff_samples, weight_above


def average_plant(models: Sequence[IdentifiedModel]) -> TransferFunction:
    """The plant in the middle: one model's own, or the mean impulse response of several, as an FIR system.

    An experiment that joins the configurations identifies this same mean (footnote 3 of chapter 3 of the source).

    Raises BadInput for no model or different sample times.
    """
    if not models:
        raise BadInput("average plant: no identified model was given")
    steps = {model.sample_time for model in models}
    if len(steps) > 1:
        raise BadInput(
            f"average plant: models have sample times {sorted(steps)}; all must be equal; identify them from records of one rate"
        )
    if len(models) == 1:
        return models[0].transfer_function()
    length = max(model.delay + model.order for model in models)
    mean = np.zeros(length)
    for model in models:
        mean[model.delay : model.delay + model.order] += model.impulse_response / len(models)
    return TransferFunction(mean, np.r_[1.0, np.zeros(length - 1)], models[0].sample_time)


@one_thread_if_small(LARGEST_FOR_ONE_THREAD)
def overall_uncertainty(
    models: Sequence[IdentifiedModel],
    average: TransferFunction,
    omega: FloatArray,
    *,
    n_samples: int | None = None,
    order: int | None = 2,
    seed: int = 0,
) -> tuple[TransferFunction, FloatArray]:
    """(Ŵ_T(z), Ω): a weight above the largest relative error of random plants of every model, (3.2).

    Ω is returned on `omega`; the weight lies above it between these frequencies too (`weight_above`).

    Parameters
    ----------
    n_samples : int or None
        Random plants in all, shared equally; None: (2.24) at ε = ζ = 0.05, 738.
    """
    each = int(np.ceil((n_samples or chernoff_samples(0.05, 0.95)) / len(models)))
    nominal = average.frequency_response(omega)
    if np.any(np.abs(nominal) < 1e-12 * np.abs(nominal).max()):
        raise BadInput("overall uncertainty: the average plant has a zero on the grid, where a relative error means nothing")
    sample_time = float(average.sample_time or 0.0)
    lag = len(average.den) - len(average.num)
    middle = np.r_[np.zeros(lag), average.num][None], np.trim_zeros(average.den, "b")[None]
    errors = DrawnErrors.joined(
        [
            DrawnErrors.of(
                model.sample_polynomials(each, np.random.default_rng([seed, number])), middle, sample_time, "multiplicative"
            )
            for number, model in enumerate(models)
        ]
    )
    grid, largest = refined_grid(errors.envelope, average.frequency_response, errors.lags, sample_time, omega)
    weight, _ = weight_above(errors, grid, largest, order)
    return weight, largest[np.searchsorted(grid, omega)]
