"""What a model's prediction leaves over of each output, watched by a robust residual."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Self

from residuum.diagnosis.diagnosers.robust_residual import RobustResidual
from residuum.diagnosis.finding import Finding, Verdict
from residuum.diagnosis.residuals.generators.physical_prediction import PREDICTION, with_prediction
from residuum.identification.errors import BadRecord
from residuum.identification.physics import PhysicalModel
from residuum.identification.record import Record

_WORST_FIRST = (Verdict.FAULTY, Verdict.NOT_ASSESSABLE, Verdict.HEALTHY)


class PhysicalResidual:
    """One robust residual an output, from the model's prediction to the measurement; the worst
    finding is the answer.

    Parameters
    ----------
    model : PhysicalModel
    settings
        Of `RobustResidual`: `order`, `gamma`, `false_alarms_per_day`.
    """

    name = "physical-residual"

    def __init__(self, model: PhysicalModel, **settings: Any) -> None:
        self.model, self.settings = model, settings
        self._watches: dict[str, RobustResidual] = {}

    def fit(self, records: Sequence[Record], labels: Sequence[str] | None = None) -> Self:
        """Learn each output's residual from healthy records.

        Raises
        ------
        BadRecord
            No output of the model is in every record.
        """
        measured = [
            name for name in self.model.outputs if all(name in record.names for record in records)
        ]
        if not measured:
            raise BadRecord(
                f"model {self.model.name!r}: no output of it is in every record; it has"
                f" {', '.join(self.model.outputs)}"
            )
        for name in measured:
            watch = RobustResidual(input=PREDICTION, output=name, **self.settings)
            self._watches[name] = watch.fit(
                [self._beside(record, name) for record in records], labels
            )
        return self

    def score(self, record: Record) -> Finding:
        """Judge one window by every output; indicators are named `glr@output`."""
        findings = {
            name: watch.score(self._beside(record, name)) for name, watch in self._watches.items()
        }
        name, worst = min(findings.items(), key=lambda item: _order(item[1]))
        return replace(
            worst,
            diagnoser=self.name,
            indicators=_joined({n: f.indicators for n, f in findings.items()}),
            thresholds=_joined({n: f.thresholds for n, f in findings.items()}),
            units=_joined({n: f.units for n, f in findings.items()}),
            evidence=dict(worst.evidence) | {"output": name},
            reason=None if worst.reason is None else f"{name}: {worst.reason}",
        )

    def _beside(self, record: Record, output: str) -> Record:
        return with_prediction(self.model, record, output)


def _order(finding: Finding) -> tuple[int, float]:
    return _WORST_FIRST.index(finding.verdict), -finding.indicators.get("glr", 0.0)


def _joined(parts: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    return {f"{key}@{name}": value for name, part in parts.items() for key, value in part.items()}
