"""What `model.improve(record)` and `model.estimate(record)` give."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import numpy as np

from residuum.identification.discrepancy.improvement import Improvement as Improved
from residuum.identification.errors import NotIdentifiable
from residuum.identification.physics import Estimate, Experiment
from residuum.identification.physics.estimation.unsettled import disagreement
from residuum.identification.physics.simulate.record_checks import begins_elsewhere, leaves_tables
from residuum.library.answers.comparison import warning_lines
from residuum.library.answers.estimation import estimate_json, estimate_text
from residuum.library.answers.improvement import improvement_json, improvement_text, step_text
from residuum.library.picture import Bars, Curve, Panel, Picture, axis
from residuum.library.result import Result, Row

M = TypeVar("M")
"""The library's `Model`, which returns these results."""


@dataclass(frozen=True, eq=False, repr=False)
class Improvement(Result, Generic[M]):
    """A model with the effects that were missing, and how its error on data kept aside fell.

    Attributes
    ----------
    model : Model
        The improved model, estimated on everything; `model.save("better.yaml")` writes it.
    found : Improvement
        The full numbers: `found.explanation`, `found.aside`, …
    warnings : tuple of str
        What of the model as it was the records contradict before anything is simulated.

    Examples
    --------
    >>> import residuum as rs
    >>> hidden = {"coulomb-friction": "large"}
    >>> record = rs.simulate("gate-drive", effects=hidden, duration=20.0, seed=1)
    >>> better = rs.model("gate-drive").improve(record, add=["coulomb-friction"])
    >>> before, after = better.history
    >>> [before["added"], after["added"]], after["error"] < 0.5 * before["error"]
    ([None, 'coulomb-friction'], True)
    """

    model: M
    found: Improved
    warnings: tuple[str, ...] = ()

    @property
    def verdict(self) -> str:
        """What `compare` says of the improved model: `adequate`, `missing-effect` or
        `unknown-effect`.
        """
        return self.found.verdict

    @property
    def history(self) -> list[dict[str, Any]]:
        """One entry a step: what was `added` (None: the model as it was) and the `error` after it,
        on data kept aside.
        """
        history: list[dict[str, Any]] = self.to_dict()["history"]
        return history

    def _answer(self) -> dict[str, Any]:
        return improvement_json(self.found, None) | {"warnings": self.warnings}

    def __str__(self) -> str:
        return "\n".join([*warning_lines(self.warnings), improvement_text(self.found, None)])

    def __repr__(self) -> str:
        return (
            f"<residuum Improvement: {self.verdict};"
            f" {', '.join(str(s['added']) for s in self.history[1:]) or 'nothing added'}>"
        )

    def _rows(self) -> Sequence[Row]:
        unit = self.found.error_unit
        return [
            {"added": step_text(step), "error": step.error, "unit": unit}
            for step in self.found.history
        ]

    def _picture(self) -> Picture:
        rows, unit = self._rows(), self.found.error_unit
        bars = Bars(
            [r["added"] for r in rows],
            [r["error"] for r in rows],
            [f"{r['error']:.3g} {unit}" for r in rows],
        )
        return Picture(
            [
                Panel(
                    f"error of {self.found.output} on data kept aside",
                    "",
                    axis("RMS error", unit),
                    bars,
                )
            ]
        )


@dataclass(frozen=True, eq=False, repr=False)
class Estimation(Result, Generic[M]):
    """A model's parameters from records, its structure as it was.

    Attributes
    ----------
    fitted : Model
        With the estimated values, settled or not.
    model : Model
        The same where the search came to rest (or `anyway` was said); `model.save("fitted.yaml")`
        writes it.
    unsettled : tuple of str
        Why the search did not come to rest; empty where it did, be it at a bound.
    records : tuple of str
    method : str
        `simulation`, `prediction` or `kalman`.
    held_out_rmse : mapping of output to float, or None
        RMS error on the parts after the records' split notes.
    left_out : tuple of str
        What of the records no sensor measured.
    found : Estimate
        The full numbers: values, covariance, flat directions, residuals.
    experiments : list of Experiment
        What the values were estimated from.
    slopes : mapping of parameter to mapping
        Of an FMU's parameters: `by` what their slopes were had, and the `step` of differences with
        the `error` that it leaves.

    Examples
    --------
    >>> import residuum as rs
    >>> record = rs.simulate("linear-axis", duration=4.0, seed=1)
    >>> rs.model("linear-axis").estimate(record).to_dict()["parameters"]["M"]["unit"]
    'kg'
    """

    fitted: M
    given: str
    records: tuple[str, ...]
    method: str
    held_out_rmse: Mapping[str, float] | None
    found: Estimate
    experiments: Sequence[Experiment]
    unsettled: tuple[str, ...] = ()
    anyway: bool = False
    left_out: tuple[str, ...] = ()
    slopes: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    @property
    def model(self) -> M:
        """The model with the estimated values; NotIdentifiable where the search did not come to
        rest.
        """
        # A value at its bound is an answer: a first model that lacks physics fits with a friction
        # at zero, and is what the next question begins with. Values that a search left on its way
        # are none.
        if self.unsettled and not self.anyway:
            raise NotIdentifiable(
                f"the estimation has not converged: {'; '.join(self.unsettled)}; `anyway=True`"
                " gives its model all the same"
            )
        return self.fitted

    @property
    def converged(self) -> bool:
        """Whether the search came to rest within the bounds."""
        return not (self.unsettled or self.found.at_bound)

    @property
    def parameters(self) -> dict[str, dict[str, Any]]:
        """Value, standard deviation and unit of each estimated parameter."""
        parameters: dict[str, dict[str, Any]] = self.to_dict()["parameters"]
        return parameters

    def _answer(self) -> dict[str, Any]:
        answer = estimate_json(self.given, self.records, self.found, self.unsettled)
        # Values of a search that did not come to rest contradict nothing yet.
        against = disagreement(self.found) if self.converged else ()
        given = self.found.model, self.experiments
        answer["warnings"] = (
            *begins_elsewhere(*given),
            *leaves_tables(*given),
            *self.left_out,
            *against,
        )
        return (
            answer
            | {
                "method": self.method,
                "held_out_rmse": self.held_out_rmse,
                "model_file": None,
            }
            | ({"slopes": self.slopes} if self.slopes else {})
        )

    def __str__(self) -> str:
        return estimate_text(self._answer())

    def _rows(self) -> Sequence[Row]:
        return [
            {"parameter": name} | values for name, values in self._answer()["parameters"].items()
        ]

    def _picture(self) -> Picture:
        experiment, predicted = self.experiments[0], self.found.predicted[0]
        time = experiment.t0 + experiment.sample_time * np.arange(experiment.n)
        panels = []
        for k, output in enumerate(self.found.model.outputs.values()):
            # An output that the record lacks has nothing to be drawn beside.
            if experiment.measured[k]:
                measured, model = (
                    Curve("measured", time, experiment.Y[:, k]),
                    Curve("model", time, predicted[:, k]),
                )
                panels.append(
                    Panel(
                        output.name, "time [s]", axis(output.name, output.unit), [measured, model]
                    )
                )
        return Picture(panels)
