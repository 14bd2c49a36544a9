"""The methods that identify a linear model, by name, each on one asked."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from residuum.identification.errors import NotIdentifiable
from residuum.identification.kernel_based.delay import estimate_delay
from residuum.identification.kernel_based.impulse_response import identify_impulse_response
from residuum.identification.linear_models.error_bounds.error_models import (
    ERROR_MODELS,
    likeliest_embedding,
)
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.integrating import integrated, summed_input
from residuum.identification.linear_models.plant_tests import (
    dead_time,
    feedback_test,
    long_autoregression,
)
from residuum.identification.linear_models.prediction_error import STRUCTURES, Orders
from residuum.identification.linear_models.prediction_error import (
    identify as identify_prediction_error,
)
from residuum.identification.linear_models.prediction_error.regularised_regression import (
    PENALTIES,
    identify_regularised,
)
from residuum.identification.linear_models.set_membership import identify_set_membership
from residuum.identification.record import Record
from residuum.library.questions.identify import LAGS, Identify

NOISE_MODELLED = ("arx", "armax", "bj")
"""Methods whose noise model makes them right in a closed loop."""
# Delays that are always tried, and how far beyond where the input acts for certain.
_LONGEST_DELAY, _DELAYS_BEYOND = 20, 5
# Delays at most that are compared by fits where the input answers the output.
_DELAYS_IN_A_LOOP = 8
_NO_DELAY_ZERO = (
    "delay 0 was left out of the estimate: a plant that answers within the sample looks like a"
    " loop; give `delay` 0 if it is one"
)


def identified_by(
    records: Sequence[Record], asked: Identify, like: IdentifiedModel | None = None
) -> IdentifiedModel:
    """The model that the method finds, behind an integrator where one is asked for.

    `like` is a model of the same plant and method: the search begins there, and what only describes
    the model is left out.
    """
    # Behind an integrator the model is one from the summed input, and gets its pole at one
    # afterwards.
    method = _METHODS[asked.method]
    if not asked.integrator:
        return method(records, asked, like)
    return integrated(
        method(summed_input(records, asked.input_name, asked.output_name), asked, like)
    )


def _kernel(
    records: Sequence[Record], asked: Identify, like: IdentifiedModel | None
) -> IdentifiedModel:
    order = LAGS if asked.order is None else asked.order
    delay = _delay(records, asked)
    return identify_impulse_response(
        records,
        asked.input_name,
        asked.output_name,
        kernel=asked.kernel,
        order=order,
        delay=delay,
        noise_variance=asked.noise_variance,
        offset=asked.offset,
        # Bands know the doubt of the hyper-parameters, but for a fit that only serves a comparison.
        hyper_uncertainty=like is None or asked.check,
        cover_cut=like is None,
        like=like,
    )


def _delay(records: Sequence[Record], asked: Identify) -> int:
    if asked.delay is not None:
        return asked.delay
    # The likelihood of a delay far below where the input acts is flat: candidates go beyond that.
    longest = max(_LONGEST_DELAY, _first_significant_lag(records, asked) + _DELAYS_BEYOND)
    try:
        return estimate_delay(
            records,
            asked.input_name,
            asked.output_name,
            kernel=asked.kernel,
            offset=asked.offset,
            longest=longest,
        ).delay
    except NotIdentifiable:
        # too short to compare delays; whether a response can be told at all, its own estimate says
        return 1


def _first_significant_lag(records: Sequence[Record], asked: Identify) -> int:
    """When the input acts for certain: the likelihood of a delay far below that is flat, and its
    candidates have to go beyond.
    """
    try:
        lag = dead_time(
            long_autoregression(records, asked.input_name, asked.output_name, first_lag=0)
        )
    except NotIdentifiable:
        return 0
    return lag or 0


def _delays_in_a_loop(records: Sequence[Record], asked: Identify) -> list[int]:
    """Delays to be compared where the input answers the output's noise; none where it does not.

    The kernel's likelihood knows no noise model: in a loop it takes the controller's answer for the
    plant's, at lag 0. From lag 1 on a model with its noise is right, and no delay can be longer
    than where the long autoregression sees the input act.
    """
    try:
        autoregression = long_autoregression(records, asked.input_name, asked.output_name)
    except NotIdentifiable:
        return []
    # Without feedback the kernel's likelihood compares delays, lag 0 among them.
    answers = feedback_test(autoregression)
    if answers is None or not answers.present:
        return []
    # Spread evenly, both ends among them: each delay costs a fit of its own.
    latest = dead_time(autoregression) or 1
    return sorted(
        {round(float(delay)) for delay in np.linspace(1, latest, min(latest, _DELAYS_IN_A_LOOP))}
    )


def _criterion_a_sample(model: IdentifiedModel) -> float:
    """BIC over the number of samples, for a longer delay leaves a model fewer."""
    return float("inf") if model.bic is None else model.bic / float(model.provenance["n"])


def _penalised(
    penalty: str,
) -> Callable[[Sequence[Record], Identify, IdentifiedModel | None], IdentifiedModel]:
    def identify_penalised(
        records: Sequence[Record], asked: Identify, _like: IdentifiedModel | None
    ) -> IdentifiedModel:
        orders = Orders(
            nb=LAGS if asked.order is None else asked.order, delay=_delay(records, asked)
        )
        return identify_regularised(
            records,
            asked.input_name,
            asked.output_name,
            orders=orders,
            penalty=penalty,
            offset=asked.offset,
        )

    return identify_penalised


def _parametric(
    structure: str,
) -> Callable[[Sequence[Record], Identify, IdentifiedModel | None], IdentifiedModel]:
    def identify_structure(
        records: Sequence[Record], asked: Identify, _like: IdentifiedModel | None
    ) -> IdentifiedModel:
        delays = (
            _delays_in_a_loop(records, asked)
            if asked.delay is None and structure in NOISE_MODELLED
            else []
        )
        if delays:
            best_model = min(
                (fitted(records, asked, delay) for delay in delays), key=_criterion_a_sample
            )
            return replace(best_model, warnings=(*best_model.warnings, _NO_DELAY_ZERO))
        # A time series has no input that could come late.
        return fitted(
            records, asked, _delay(records, asked) if STRUCTURES[structure].has_input else 1
        )

    def fitted(records: Sequence[Record], asked: Identify, delay: int) -> IdentifiedModel:
        return identify_prediction_error(
            STRUCTURES[structure],
            records,
            asked.input_name,
            asked.output_name,
            order=asked.order,
            delay=delay,
            offset=asked.offset,
            criterion=asked.criterion,
        )

    return identify_structure


def _set_membership(
    records: Sequence[Record], asked: Identify, _like: IdentifiedModel | None
) -> IdentifiedModel:
    delay = _delay(records, asked)
    return identify_set_membership(
        records,
        asked.input_name,
        asked.output_name,
        order=asked.order,
        delay=delay,
        noise_bound=asked.noise_bound,
        offset=asked.offset,
    )


def _stochastic_embedding(
    records: Sequence[Record], asked: Identify, _like: IdentifiedModel | None
) -> IdentifiedModel:
    delay = _delay(records, asked)
    return likeliest_embedding(
        records,
        asked.input_name,
        asked.output_name,
        delay=delay,
        order=asked.order,
        offset=asked.offset,
    )


_METHODS: dict[
    str, Callable[[Sequence[Record], Identify, IdentifiedModel | None], IdentifiedModel]
] = {
    "kernel": _kernel,
    **{penalty: _penalised(penalty) for penalty in PENALTIES},
    "set-membership": _set_membership,
    "stochastic-embedding": _stochastic_embedding,
    **{name: _parametric(name) for name in STRUCTURES},
}


def with_uncertainty(
    model: IdentifiedModel, records: Sequence[Record], asked: Identify
) -> IdentifiedModel:
    """The model with the error model that was asked for, from these records."""
    if asked.uncertainty == "own":
        return model
    return ERROR_MODELS[asked.uncertainty](model, records, asked.noise_bound)
