"""The question `identify`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Self

from pydantic import BeforeValidator, Field, field_validator, model_validator

from residuum.identification.errors import BadInput
from residuum.identification.kernel_based.impulse_response import NOISE_VARIANCE_METHODS
from residuum.identification.kernel_based.kernels import KERNELS
from residuum.identification.linear_models.error_bounds.error_models import ERROR_MODELS
from residuum.identification.linear_models.prediction_error import CRITERIA, STRUCTURES
from residuum.identification.linear_models.prediction_error.regularised_regression import PENALTIES
from residuum.library.questions import Either, Question, field

LAGS = 100
"""Length of an impulse response that nobody chose."""
METHODS = ("kernel", *PENALTIES, "set-membership", "stochastic-embedding", *STRUCTURES)
"""`ar` alone needs no input: it is the model of a time series."""

# Where a field of a model with an input counts.
_WITH_INPUT = ({"method": [method for method in METHODS if method != "ar"]},)

_Channel = Annotated[str, Field(min_length=1, max_length=200)]
_Channels = Annotated[
    _Channel | Annotated[list[_Channel], Field(min_length=1, max_length=64)],
    Either("must be a channel's name, or a list of names"),
]
_VARIANCE = f"must be a number or one of {', '.join(NOISE_VARIANCE_METHODS)}"


def _number(given: object) -> object:
    """A number that was written as text."""
    try:
        # On a command line a variance comes as a text, as the names of methods do.
        return float(given) if isinstance(given, str) else given
    except ValueError:
        return given


class Identify(Question):
    """A linear model from one channel to another, or from several to several, with its
    uncertainty.
    """

    input: _Channels | None = field(
        None,
        "Channel of the input u, or of several that act together. Method ar needs none.",
        only_with=_WITH_INPUT,
        example="voltage",
    )
    output: _Channels = field(
        ..., "Channel of the output y. Several outputs: one model each.", example="speed"
    )
    method: str = field(
        "kernel",
        "Regularised impulse response (kernel), penalised ones (ridge, lasso, elastic-net), one"
        " from a bound on the noise (set-membership), Laguerre functions with a random error"
        " (stochastic-embedding), a time series (ar), or a transfer function.",
        choices=METHODS,
    )
    kernel: str = field("tc", "Prior of the impulse response.", choices=KERNELS)
    # The longest is that of the kernel method.
    order: int | None = field(
        None,
        f"Length m of the impulse response (kernel: {LAGS}), or order of the model (others: by the"
        " criterion).",
        ge=1,
        le=5000,
    )
    criterion: str = field(
        "bic",
        "How the order of a model is chosen.",
        choices=CRITERIA,
        only_with=({"method": STRUCTURES},),
    )
    delay: int | None = field(
        None,
        "Samples n_k before the input acts; default: estimated (of several inputs or outputs: 1).",
        only_with=_WITH_INPUT,
        ge=0,
        le=10_000,
    )
    noise_variance: Annotated[float | str, Either(_VARIANCE), BeforeValidator(_number)] = field(
        "marginal",
        f"Variance of the noise: {', '.join(NOISE_VARIANCE_METHODS)}, or a number σ² [output"
        " unit²].",
        only_with=({"method": ["kernel"]},),
    )
    offset: bool = field(
        True, "Fit a constant level as well; not where the signals are deviations already."
    )
    uncertainty: str = field(
        "own",
        "How far to trust the model: by the covariance of its own estimate, or by an error model"
        " from data kept aside.",
        choices=("own", *ERROR_MODELS),
        only_with=_WITH_INPUT,
    )
    noise_bound: float | None = field(
        None,
        "Largest noise of set-membership [output unit]; default: 1.1 times the smallest possible.",
        only_with=({"method": ["set-membership"]}, {"uncertainty": ["set-membership"]}),
        gt=0,
        le=1e300,
    )
    integrator: bool = field(
        False,
        "The plant integrates: identify from the summed input, with a pole at one behind.",
        only_with=_WITH_INPUT,
    )
    check: bool = field(
        False,
        "Test the residuals on data kept aside (white, free of the input, model error model), and"
        " tell the error on new data by the .632+ bootstrap.",
        only_with=_WITH_INPUT,
    )

    earlier: ClassVar[Mapping[str, Mapping[str, Any]]] = {"delay": {"estimate": None}}

    @property
    def inputs(self) -> tuple[str, ...]:
        """The input channels."""
        return _names(self.input)

    @property
    def outputs(self) -> tuple[str, ...]:
        """The output channels."""
        return _names(self.output)

    @property
    def input_name(self) -> str:
        """The input of a model with one; empty for a time series."""
        return self.inputs[0] if self.inputs else ""

    @property
    def output_name(self) -> str:
        """The output of a model with one."""
        return self.outputs[0]

    @property
    def is_multivariable(self) -> bool:
        """Whether several inputs or outputs are asked for."""
        return len(self.inputs) > 1 or len(self.outputs) > 1

    @field_validator("noise_variance")
    @classmethod
    def _is_variance(cls, value: float | str) -> float | str:
        if isinstance(value, str) and value not in NOISE_VARIANCE_METHODS:
            raise BadInput(repr(value), "noise_variance", _VARIANCE)
        if isinstance(value, float) and value <= 0:
            raise BadInput(repr(value), "noise_variance", "must be > 0")
        return value

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        """What belongs to other methods, to a model with an input, or to a single path is refused
        before any work.
        """
        # One refusal is told: what a model cannot be without comes before what it does not need.
        self._refuse_missing_input()
        self._refuse_of_single_path()
        self._refuse_of_input()
        if self.integrator and self._is_bounded:
            raise BadInput(
                repr(self.uncertainty),
                "uncertainty",
                "bounds errors that decay, which a plant that integrates has not",
            )
        if self.noise_bound is not None and "set-membership" not in (self.uncertainty, self.method):
            raise BadInput(
                "",
                "noise_bound",
                "is used by the uncertainty set-membership alone, and by the method of that name",
            )
        return self

    @property
    def _is_series(self) -> bool:
        return self.method == "ar"

    @property
    def _is_bounded(self) -> bool:
        """Whether an error model bounds the error, instead of the estimate's own covariance."""
        return self.uncertainty != "own"

    def _refuse_missing_input(self) -> None:
        if self._is_series and self.input is not None:
            raise BadInput("'ar'", "method", "models an output alone; leave the input out")
        if not self._is_series and self.input is None:
            raise BadInput(repr(self.method), "method", "needs an input")

    def _refuse_of_single_path(self) -> None:
        of_single_path = self.method != "kernel" or self._is_bounded or self.integrator
        if self.is_multivariable and (of_single_path or self.check):
            raise BadInput(
                "several inputs or outputs: need the method kernel, the model's own uncertainty, no"
                " integrator, no check"
            )

    def _refuse_of_input(self) -> None:
        if not self._is_series:
            return
        needs_input = {
            "integrator": self.integrator,
            "uncertainty": self._is_bounded,
            "check": self.check,
        }
        for name, is_asked in needs_input.items():
            if is_asked:
                raise BadInput(
                    "", name, "needs a model with an input; a time series (method ar) has none"
                )


def _names(channels: str | list[str] | None) -> tuple[str, ...]:
    if channels is None:
        return ()
    return (channels,) if isinstance(channels, str) else tuple(channels)
