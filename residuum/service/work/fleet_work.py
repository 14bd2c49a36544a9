"""What is done with each record of a fleet, in a worker: judge it, or identify a model from it.

Every result says `by` what it was made: a mark of diagnoser, baseline and options. A run goes on only with results of its own.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

from residuum.identification.errors import BadInput
from residuum.library.answers.plain import to_plain
from residuum.library.identification_methods import identified_by
from residuum.library.questions.identify import Identify
from residuum.service.machines.judging.kept_diagnosers import diagnoser_of_file
from residuum.service.work.fleet_source import FleetSource, Folder


@dataclass(frozen=True)
class Rescore:
    """Judge a file with a diagnoser and, where there is one, its baseline."""

    diagnoser: str
    baseline: str | None
    source: FleetSource = field(default_factory=Folder)

    @property
    def mark(self) -> str:
        """What the results are made by."""
        return _mark(f"rescore {self.diagnoser}", self.baseline)

    def __call__(self, file: str) -> dict[str, Any]:
        """`{"by": …, "finding": …}` or `{"by": …, "refused": …}`."""
        try:
            finding = diagnoser_of_file(self.diagnoser, self.baseline).score(self.source.read(file))
        except BadInput as error:
            return {"by": self.mark, "refused": str(error)}
        return {"by": self.mark, "finding": to_plain(finding.to_json())}


@dataclass(frozen=True)
class Reidentify:
    """Identify a model from a file."""

    asked: Identify
    source: FleetSource = field(default_factory=Folder)

    @property
    def mark(self) -> str:
        """What the results are made by."""
        return _mark(f"reidentify {self.asked!r}", None)

    def __call__(self, file: str) -> dict[str, Any]:
        """`{"by": …, "model": …}` or `{"by": …, "refused": …}`."""
        try:
            model = identified_by([self.source.read(file)], self.asked)
        except BadInput as error:
            return {"by": self.mark, "refused": str(error)}
        told = {
            "method": model.method,
            "order": model.order,
            "delay": model.delay,
            "sample_time": model.sample_time,
            "impulse_response": model.impulse_response,
            "std": model.std,
            "noise_variance": model.noise_variance,
            "numerator": model.numerator,
            "denominator": model.denominator,
            "warnings": list(model.warnings),
        }
        return {"by": self.mark, "model": to_plain(told)}


@lru_cache(maxsize=4)
def _mark(asked: str, baseline: str | None) -> str:
    content = b"" if baseline is None else Path(baseline).read_bytes()
    return hashlib.sha256(asked.encode() + b"\n" + content).hexdigest()[:16]
