"""The question `estimate`."""

from __future__ import annotations

from residuum.library.questions import Question, field
from residuum.library.questions.names import Names


class Estimate(Question):
    """The free parameters of a model from records, its structure as it is."""

    free: Names = field(
        None,
        "Estimate these parameters, and hold all others. Default: those that the model does not"
        " hold fixed; of an FMU they have to be named.",
    )
    method: str = field(
        "simulation",
        "The error that is minimised: of simulation, of prediction (so many `steps` ahead), or"
        " kalman (innovations).",
        choices=("simulation", "prediction", "kalman"),
    )
    steps: int = field(
        50,
        "Samples predicted ahead (method prediction).",
        only_with=({"method": ["prediction"]},),
        ge=2,
        le=1_000_000,
    )
    hold: str = field("auto", "Inputs between samples.", choices=("auto", "linear", "zero-order"))
    anyway: bool = field(
        False, "Give the model also where the search has not come to rest, which is refused else."
    )
