"""Control of a plant with as many outputs as inputs, as an answer."""

from __future__ import annotations

from os import PathLike
from typing import Any

from residuum.identification.errors import BadInput
from residuum.identification.kernel_based.multivariable_file import load_multivariable
from residuum.library.answers.multivariable_control import design_json
from residuum.library.answers.plain import to_plain
from residuum.nearest_names import known_names
from residuum.robust_control.control_problem import STRUCTURES, WeightChoice, Wishes
from residuum.robust_control.multivariable_control import MultivariableProblem


def design_multivariable(
    file: str | PathLike[str],
    *,
    structure: str = "pidn",
    wishes: Wishes | None = None,
    weight: WeightChoice | None = None,
    seed: int = 0,
) -> dict[str, Any]:
    """The `control design` object: a static decoupler, and a controller of the structure for every output.

    Raises
    ------
    BadInput, BadModel
        An unknown structure, another aim than the nominal one, a file or plant that does not suit.
    Infeasible
        No controller of the structure meets the aim in a loop.
    """
    if structure not in STRUCTURES:
        raise BadInput(f"structure {structure!r}: there is none of this name; {known_names(structure, STRUCTURES)}")
    problem = MultivariableProblem(load_multivariable(str(file)), seed, weight)
    found = problem.solve(STRUCTURES[structure](problem.sample_time), wishes or Wishes())
    asked = {"aim": "nominal", "structure": structure, "models": [str(file)]}
    plain: dict[str, Any] = to_plain(asked | design_json(problem, found) | {"file": None})
    return plain
