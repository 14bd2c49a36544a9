"""Control of a plant with as many outputs as inputs, as an answer."""

from __future__ import annotations

from os import PathLike
from typing import Any

from residuum.identification.errors import BadInput
from residuum.identification.kernel_based.multivariable import load_multivariable
from residuum.library.answers.multivariable_control import design_json
from residuum.library.answers.plain import to_plain
from residuum.library.questions.control_design import DesignController
from residuum.robust_control.control_problem import STRUCTURES, WeightChoice, Wishes
from residuum.robust_control.multivariable_control import MultivariableProblem


def design_multivariable(file: str | PathLike[str], asked: DesignController) -> dict[str, Any]:
    """The `control design` object: a static decoupler, and a controller of the structure for every
    output.

    Raises
    ------
    BadInput, BadModel
        Another aim than the nominal one, what single loops have alone, a file or plant that does
        not suit.
    Infeasible
        No controller of the structure meets the aim in a loop.
    """
    for name in ("fix", "within", "limits"):
        if getattr(asked, name):
            raise BadInput("", name, "is for a plant of one input and one output; leave it out")
    problem = MultivariableProblem(
        load_multivariable(str(file)), asked.seed, asked.handed_to(WeightChoice)
    )
    design = problem.solve(
        STRUCTURES[asked.structure](problem.sample_time), asked.handed_to(Wishes)
    )
    described = {"aim": "nominal", "structure": asked.structure, "models": [str(file)]}
    plain: dict[str, Any] = to_plain(described | design_json(problem, design) | {"file": None})
    return plain
