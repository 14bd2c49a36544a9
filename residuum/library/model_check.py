"""What residual tests and the bootstrap say of an identified model, as JSON and as lines of the
report.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from residuum.identification.errors import BadInput
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.validation import (
    LEVEL,
    BlockBootstrap,
    ModelErrorModel,
    ResidualCheck,
    ResidualTest,
    block_bootstrap,
    residual_check,
)
from residuum.identification.record import Record
from residuum.library.model_assumptions import Part, identified_again
from residuum.library.questions.identify import Identify


@dataclass(frozen=True, eq=False)
class ModelCheck:
    """The tests of every part kept aside, and the .632+ estimate of the error on new data.

    Attributes
    ----------
    parts : tuple of ResidualCheck
    bootstrap : BlockBootstrap or None
    reasons : tuple of str
        Why something is missing.
    output_unit : str
    """

    parts: tuple[ResidualCheck, ...]
    bootstrap: BlockBootstrap | None
    reasons: tuple[str, ...]
    output_unit: str

    @property
    def passed(self) -> bool:
        """Whether no test speaks against the model."""
        return all(part.passed for part in self.parts)

    def to_dict(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "level": LEVEL,
            "passed": self.passed,
            "parts": [_part_json(part) for part in self.parts],
            "bootstrap": None if self.bootstrap is None else asdict(self.bootstrap),
            "reasons": list(self.reasons),
        }

    def lines(self) -> list[str]:
        """As lines of the report."""
        says = [line for part in self.parts for line in _part_lines(part)]
        if self.bootstrap is not None:
            unit = f" {self.output_unit}" if self.output_unit else ""
            sizes = [
                math.sqrt(value)
                for value in (
                    self.bootstrap.error,
                    self.bootstrap.apparent,
                    self.bootstrap.out_of_bag,
                )
            ]
            says.append(
                f"  new data          error {sizes[0]:.4g}{unit} RMS by the .632+ bootstrap of"
                f" {self.bootstrap.blocks} blocks ({sizes[1]:.4g} on its own data, {sizes[2]:.4g}"
                " on blocks left out)"
            )
        return says + [f"  not checked       {reason}" for reason in self.reasons]


def model_check(
    model: IdentifiedModel, asked: Identify, parts: Sequence[Part], records: Sequence[Record]
) -> ModelCheck:
    """Check a model on the parts that it has not seen, and on blocks of `records`, which it was
    identified from.
    """
    checks, reasons = (
        [],
        (
            []
            if parts
            else ["residuals: nothing could be kept aside; record longer, or take a smaller order"]
        ),
    )
    for part in parts:
        try:
            checks.append(residual_check(part.model, part.record, part.first))
        except BadInput as error:
            reasons.append(f"residuals: {error}")
    bootstrap = None
    try:
        bootstrap = block_bootstrap(
            lambda blocks: identified_again(model, blocks, asked), model, records
        )
    except BadInput as error:
        reasons.append(str(error))
    return ModelCheck(tuple(checks), bootstrap, tuple(reasons), model.output_unit)


def _part_json(part: ResidualCheck) -> dict[str, Any]:
    return {
        "samples": part.samples,
        "passed": part.passed,
        "whiteness": _test_json(part.whiteness),
        "input_correlation": _test_json(part.input),
        "model_error": _error_json(part.model_error),
    }


def _test_json(test: ResidualTest | None) -> dict[str, Any] | None:
    if test is None:
        return None
    return {
        "lags": test.lags,
        "correlation": test.correlation,
        "band": test.band,
        "statistic": test.statistic,
        "degrees_of_freedom": test.degrees_of_freedom,
        "p_value": test.p_value,
        "passed": test.passed,
    }


def _error_json(error: ModelErrorModel | None) -> dict[str, Any] | None:
    if error is None:
        return None
    return {
        "falsified": error.falsified,
        "falsified_at": error.falsified_at,
        "frequencies": len(error.omega),
    }


def _part_lines(part: ResidualCheck) -> list[str]:
    white = "needs a noise model" if part.whiteness is None else _verdict(part.whiteness)
    free = "too short to tell" if part.input is None else _verdict(part.input)
    lines = [
        f"  residuals         white: {white}; free of the input: {free}; {part.samples} samples"
        " kept aside"
    ]
    if part.model_error is not None:
        error = part.model_error
        where = f"falsified at {len(error.falsified_at)} of {len(error.omega)} frequencies"
        if error.falsified:
            where += f", {error.falsified_at[0]:.3g} to {error.falsified_at[-1]:.3g} rad/s"
        lines.append(
            f"  model error       {where if error.falsified else 'not falsified at any frequency'}"
        )
    return lines


def _verdict(test: ResidualTest) -> str:
    answer = "yes" if test.passed else "no"
    return (
        f"{answer} (p {test.p_value:.2g}, level {test.level:g}, lags {test.lags[0]} to"
        f" {test.lags[-1]})"
    )
