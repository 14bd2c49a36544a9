"""The questions `residual design` and `residual run`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import get_args

from residuum.diagnosis.residuals.generators.classical_filters import CLASSICAL_METHODS
from residuum.diagnosis.residuals.multivariable import UNKNOWN_INPUT
from residuum.diagnosis.residuals.residual_design import ROBUST, ResidualDesign, design_residual
from residuum.diagnosis.thresholds.threshold import EvaluationName, ThresholdKind
from residuum.identification.errors import BadInput
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.record import Record
from residuum.library.questions import Question, field
from residuum.library.questions.uncertainty import WeightQuestion, weight_for


class DesignResidual(WeightQuestion):
    """A residual generator from an identified model, its noise learned from healthy records."""

    fault: str = field(
        "sensor", "Kind of fault to be most sensitive to.", choices=("sensor", "actuator")
    )
    method: str = field(
        ROBUST,
        f"Method for the post-filter: Algorithm 5 ({ROBUST}), or a classical residual generator; of"
        f" a model with several inputs and outputs: {ROBUST}, {UNKNOWN_INPUT}.",
        choices=(ROBUST, *CLASSICAL_METHODS, UNKNOWN_INPUT),
    )
    unknown_input: list[str] | None = field(
        None,
        f"Input that will not be measured, of {UNKNOWN_INPUT}.",
        only_with=({"method": [UNKNOWN_INPUT]},),
    )
    gamma: float = field(
        0.1, "Largest gain from model error and noise to the residual, γ.", gt=0, le=1e6
    )


class RunResidual(Question):
    """What a residual design says of a record."""

    threshold: str = field("posterior", "Kind of threshold.", choices=get_args(ThresholdKind))
    # At most one a second.
    false_alarms_per_day: float = field(
        1.0,
        "Number of false alarms a day that is accepted, for the posterior and the calibrated"
        " threshold.",
        only_with=({"threshold": ["posterior", "calibrated"]},),
        gt=0,
        le=86400,
    )
    evaluation: str | None = field(
        None,
        "How the residual is evaluated. Default: glr (likelihood ratio over windows); point for"
        " source and peak.",
        choices=get_args(EvaluationName),
    )
    noise_bound: float | None = field(
        None,
        "Largest noise, for source and peak [output unit].",
        only_with=({"threshold": ["source", "peak"]},),
        gt=0,
        le=1e300,
    )


def residual_for(
    model: IdentifiedModel, healthy: Sequence[Record], asked: DesignResidual
) -> ResidualDesign:
    """The design for a model of one input and one output.

    Raises
    ------
    BadInput
        What a model of several outputs has alone; a model or records that do not suit.
    """
    if asked.unknown_input or asked.method == UNKNOWN_INPUT:
        # The field that was set is named, of the two that a model of one output has no use for.
        where = "method" if asked.method == UNKNOWN_INPUT else "unknown_input"
        setting = repr(asked.method if where == "method" else asked.unknown_input)
        raise BadInput(
            setting,
            where,
            "needs a model with several outputs, as identify makes of several",
        )
    chosen = asked.model_dump(include={"fault", "gamma", "method"})
    return design_residual(model, weight_for(model, asked).weight, healthy, **chosen)
