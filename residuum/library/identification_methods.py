"""The methods that identify a linear model, by name, each on one request."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.kernel_based.delay import estimate_delay
from residuum.identification.kernel_based.impulse_response import identify_impulse_response
from residuum.identification.linear_models.error_bounds.error_models import ERROR_MODELS, likeliest_embedding
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.integrating import integrated, summed_input
from residuum.identification.linear_models.plant_tests.dead_time import dead_time
from residuum.identification.linear_models.plant_tests.feedback import feedback_test
from residuum.identification.linear_models.plant_tests.long_autoregression import long_autoregression
from residuum.identification.linear_models.prediction_error import CRITERIA, STRUCTURES, Orders
from residuum.identification.linear_models.prediction_error import identify as identify_prediction_error
from residuum.identification.linear_models.prediction_error.regularised_regression import PENALTIES, identify_regularised
from residuum.identification.linear_models.set_membership_response import identify_set_membership
from residuum.identification.record import Record
from residuum.nearest_names import known_names

__all__ = [
    "CRITERIA",
    "LAGS",
    "METHODS",
    "NOISE_MODELLED",
    "UNCERTAINTIES",
    "Request",
    "check_method",
    "identified_by",
    "with_uncertainty",
]
UNCERTAINTIES = ("own", *ERROR_MODELS)
"""How far to trust a model: by the covariance of its own estimate, or by an error model from records."""
NOISE_MODELLED = ("arx", "armax", "bj")
"""Methods whose noise model makes them right in a closed loop."""
LAGS = 100
"""Length of an impulse response that nobody chose."""
_LONGEST_DELAY, _DELAYS_BEYOND = 20, 5
"""Delays that are always tried, and how far beyond where the input acts for certain."""
_DELAYS_IN_A_LOOP = 8
_NO_DELAY_ZERO = (
    "delay 0 was left out of the estimate: a plant that answers within the sample looks like a loop; give `delay` 0 if it is one"
)


@dataclass(frozen=True)
class Request:
    """What the user asked of an identification method; None = the method's own choice."""

    input: str
    output: str
    order: int | None
    delay: int | None
    kernel: str
    noise_variance: str | float
    offset: bool
    criterion: str = "bic"
    uncertainty: str = "own"
    noise_bound: float | None = None
    integrator: bool = False
    check: bool = False
    like: IdentifiedModel | None = None
    """A model of the same plant and method: the search begins there, and what only describes the model is left out."""


def identified_by(method: str, records: Sequence[Record], request: Request) -> IdentifiedModel:
    """The model that a method finds, behind an integrator where one is asked for."""
    if not request.integrator:
        return METHODS[method](records, request)
    if not STRUCTURES.get(method, STRUCTURES["arx"]).has_input:
        raise BadInput(f"integrator: belongs to a plant with an input; the method {method!r} has none")
    return integrated(METHODS[method](summed_input(records, request.input, request.output), request))


def _kernel(records: Sequence[Record], request: Request) -> IdentifiedModel:
    order = LAGS if request.order is None else request.order
    delay = _delay(records, request)
    return identify_impulse_response(
        records,
        request.input,
        request.output,
        kernel=request.kernel,
        order=order,
        delay=delay,
        noise_variance=request.noise_variance,
        offset=request.offset,
        hyper_uncertainty=request.like is None or request.check,
        cover_cut=request.like is None,
        like=request.like,
    )


def _delay(records: Sequence[Record], request: Request) -> int:
    if request.delay is not None:
        return request.delay
    longest = max(_LONGEST_DELAY, _first_significant_lag(records, request) + _DELAYS_BEYOND)
    return estimate_delay(
        records, request.input, request.output, kernel=request.kernel, offset=request.offset, longest=longest
    ).delay


def _first_significant_lag(records: Sequence[Record], request: Request) -> int:
    """When the input acts for certain: the likelihood of a delay far below that is flat, and its candidates have to go beyond."""
    try:
        found = dead_time(long_autoregression(records, request.input, request.output, first_lag=0))
    except NotIdentifiable:
        return 0
    return found or 0


def _delays_in_a_loop(records: Sequence[Record], request: Request) -> list[int]:
    """Delays to be compared where the input answers the output's noise; none where it does not.

    The kernel's likelihood knows no noise model: in a loop it takes the controller's answer for the plant's, at lag 0. From lag 1
    on a model with its noise is right, and no delay can be longer than where the long autoregression sees the input act.
    """
    try:
        found = long_autoregression(records, request.input, request.output)
    except NotIdentifiable:
        return []
    answers = feedback_test(found)
    if answers is None or not answers.present:
        return []
    latest = dead_time(found) or 1
    return sorted({round(float(delay)) for delay in np.linspace(1, latest, min(latest, _DELAYS_IN_A_LOOP))})


def _criterion_a_sample(model: IdentifiedModel) -> float:
    """BIC over the number of samples, for a longer delay leaves a model fewer."""
    return float("inf") if model.bic is None else model.bic / float(model.provenance["n"])


def _penalised(penalty: str) -> Callable[[Sequence[Record], Request], IdentifiedModel]:
    def identify_penalised(records: Sequence[Record], request: Request) -> IdentifiedModel:
        orders = Orders(nb=LAGS if request.order is None else request.order, delay=_delay(records, request))
        return identify_regularised(records, request.input, request.output, orders=orders, penalty=penalty, offset=request.offset)

    return identify_penalised


def _parametric(structure: str) -> Callable[[Sequence[Record], Request], IdentifiedModel]:
    def identify_structure(records: Sequence[Record], request: Request) -> IdentifiedModel:
        delays = _delays_in_a_loop(records, request) if request.delay is None and structure in NOISE_MODELLED else []
        if delays:
            found = min((fitted(records, request, delay) for delay in delays), key=_criterion_a_sample)
            return replace(found, warnings=(*found.warnings, _NO_DELAY_ZERO))
        return fitted(records, request, _delay(records, request) if STRUCTURES[structure].has_input else 1)

    def fitted(records: Sequence[Record], request: Request, delay: int) -> IdentifiedModel:
        return identify_prediction_error(
            STRUCTURES[structure],
            records,
            request.input,
            request.output,
            order=request.order,
            delay=delay,
            offset=request.offset,
            criterion=request.criterion,
        )

    return identify_structure


def _set_membership(records: Sequence[Record], request: Request) -> IdentifiedModel:
    delay = _delay(records, request)
    return identify_set_membership(
        records,
        request.input,
        request.output,
        order=request.order,
        delay=delay,
        noise_bound=request.noise_bound,
        offset=request.offset,
    )


def _stochastic_embedding(records: Sequence[Record], request: Request) -> IdentifiedModel:
    delay = _delay(records, request)
    return likeliest_embedding(records, request.input, request.output, delay=delay, order=request.order, offset=request.offset)


METHODS: dict[str, Callable[[Sequence[Record], Request], IdentifiedModel]] = {
    "kernel": _kernel,
    **{penalty: _penalised(penalty) for penalty in PENALTIES},
    "set-membership": _set_membership,
    "stochastic-embedding": _stochastic_embedding,
    **{name: _parametric(name) for name in STRUCTURES},
}
"""`ar` alone needs no input: it is the model of a time series."""


def with_uncertainty(model: IdentifiedModel, records: Sequence[Record], request: Request) -> IdentifiedModel:
    """The model with the error model that was asked for, from these records.

    Raises BadInput for a model without an input, or a noise bound that nothing uses.
    """
    if request.integrator and request.uncertainty != "own":
        raise BadInput(f"uncertainty {request.uncertainty!r}: bounds errors that decay, which a plant that integrates has not")
    if request.uncertainty == "own":
        if request.noise_bound is not None and model.method.split("-integrator")[0] != "set-membership":
            raise BadInput("noise bound: is used by the uncertainty set-membership alone, and by the method of that name")
        return model
    if not model.input_name:
        raise BadInput(f"uncertainty {request.uncertainty!r}: needs a model with an input; a time series has none")
    return ERROR_MODELS[request.uncertainty](model, records, request.noise_bound)


def check_method(method: str, criterion: str, uncertainty: str = "own", input: str | None = None) -> None:
    """Refuse names that there are not, with those there are, and an input too many or too few."""
    if input is not None and bool(input) == (method == "ar"):
        raise BadInput(
            "method 'ar': models an output alone; leave the input out" if input else f"method {method!r}: needs an input"
        )
    if uncertainty not in UNCERTAINTIES:
        raise BadInput(f"uncertainty {uncertainty!r}: there is none of this name; {known_names(uncertainty, UNCERTAINTIES)}")
    if method not in METHODS:
        raise BadInput(f"method {method!r}: there is none of this name; {known_names(method, METHODS)}")
    if criterion not in CRITERIA:
        raise BadInput(f"criterion {criterion!r}: there is none of this name; {known_names(criterion, CRITERIA)}")
