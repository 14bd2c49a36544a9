"""The question `uncertainty`, and what every question asks that needs the weight it makes."""

from __future__ import annotations

from residuum.identification.linear_models.error_bounds.error_models import FORMS, asked_grid
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.uncertainty import (
    SAMPLE_SIZE_RULES,
    WEIGHT_ORDER,
    UncertaintyWeight,
    design_uncertainty_weight,
)
from residuum.library.questions import Question, field


class WeightQuestion(Question):
    """What is asked of an uncertainty weight (Algorithm 1)."""

    # n ≥ ln(2/ζ)/(2ε²), (2.24): 738 models at ε = ζ = 0.05, 73 778 at the least ε with this ζ.
    epsilon: float = field(
        0.05,
        "Error ε that an estimated share of models may have. A smaller one draws more models,"
        " (2.24).",
        ge=0.005,
        le=0.5,
    )
    zeta: float = field(
        0.05,
        "Probability ζ that the error is larger than ε. A smaller one draws more models, (2.24).",
        ge=1e-6,
        le=0.5,
    )
    # Hoeffding's n is for a share. For the worst of the models n ≥ ln(1/ζ)/ln(1/(1 − ε)) does, 59
    # at ε = ζ = 0.05 (Tempo, Bai, Dabbene 1997).
    rule: str = field(
        "chernoff",
        "What ε and ζ hold for: a share of the models (chernoff), or the worst of them"
        " (worst-case).",
        choices=SAMPLE_SIZE_RULES,
    )
    weight_order: int = field(WEIGHT_ORDER, "Order of the fitted weight W_T.", ge=0, le=20)
    points: int | None = field(
        None,
        "Frequencies that the grid begins with, logarithmic up to π/Ts; it is refined anyway.",
        ge=2,
        le=5000,
    )
    lowest: float | None = field(None, "Lowest frequency of the grid [rad/s].", gt=0, le=1e12)


class Uncertainty(WeightQuestion):
    """How far the models that an identified model's distribution allows lie from it, at every
    frequency.
    """

    form: str = field("multiplicative", "Form of the error that is bounded.", choices=FORMS)
    seed: int = field(0, "Seed of the random models.", ge=0, le=2**32 - 1)


def weight_for(
    model: IdentifiedModel, asked: WeightQuestion, form: str = "multiplicative", seed: int = 0
) -> UncertaintyWeight:
    """The weight of a model.

    Raises
    ------
    BadInput
        A lowest frequency that is not below π/Ts; a model whose response is zero.
    """
    grid = asked_grid(model.sample_time, asked.points, asked.lowest)
    return design_uncertainty_weight(
        model,
        omega=grid,
        accuracy=asked.epsilon,
        confidence=1 - asked.zeta,
        rule=asked.rule,
        form=form,
        order=asked.weight_order,
        seed=seed,
    )
