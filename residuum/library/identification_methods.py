"""The methods that identify a linear model, by name, each on one request."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from residuum.identification.errors import BadInput
from residuum.identification.kernel_based.delay import estimate_delay
from residuum.identification.kernel_based.impulse_response import identify_impulse_response
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.prediction_error import CRITERIA, STRUCTURES
from residuum.identification.linear_models.prediction_error import identify as identify_prediction_error
from residuum.identification.record import Record

__all__ = ["CRITERIA", "METHODS", "Request", "check_method"]


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


def _kernel(records: Sequence[Record], request: Request) -> IdentifiedModel:
    order = 100 if request.order is None else request.order
    delay = request.delay
    if delay is None:
        delay = estimate_delay(records, request.input, request.output, kernel=request.kernel, offset=request.offset).delay
    return identify_impulse_response(
        records,
        request.input,
        request.output,
        kernel=request.kernel,
        order=order,
        delay=delay,
        noise_variance=request.noise_variance,
        offset=request.offset,
    )


def _parametric(structure: str) -> Callable[[Sequence[Record], Request], IdentifiedModel]:
    def identify_structure(records: Sequence[Record], request: Request) -> IdentifiedModel:
        delay = request.delay
        if delay is None:
            delay = estimate_delay(records, request.input, request.output, kernel=request.kernel, offset=request.offset).delay
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


METHODS: dict[str, Callable[[Sequence[Record], Request], IdentifiedModel]] = {
    "kernel": _kernel,
    **{name: _parametric(name) for name, structure in STRUCTURES.items() if structure.has_input},
}


def check_method(method: str, criterion: str) -> None:
    """Refuse names that there are not, with those there are."""
    if method not in METHODS:
        raise BadInput(f"method {method!r}: there is none of this name; known are {', '.join(METHODS)}")
    if criterion not in CRITERIA:
        raise BadInput(f"criterion {criterion!r}: there is none of this name; known are {', '.join(CRITERIA)}")
