"""Scoring in a worker process: a diagnoser is loaded once from its baseline file and judges the
windows that are sent.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from residuum.diagnosis.finding import Finding
from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.service.machines.judging.kept_diagnosers import diagnoser_of_file


class PlainRecord(NamedTuple):
    """A record as it travels between processes."""

    channels: Mapping[str, npt.NDArray[np.floating[Any]]]
    units: Mapping[str, str]
    sample_time: float
    t0: float
    source: str

    @classmethod
    def of(cls, record: Record) -> PlainRecord:
        """The record's content."""
        return cls(
            dict(record.channels), dict(record.units), record.sample_time, record.t0, record.source
        )

    def record(self) -> Record:
        """The record again."""
        return Record(self.channels, self.units, self.sample_time, t0=self.t0, source=self.source)


def score_window(
    diagnoser: str, baseline: str, window: PlainRecord, method: str | None = None
) -> Finding:
    """Judge one window with the diagnoser stored in the file `baseline`; with none (an empty name)
    by absolute indicators.

    `method` is what decides, where a diagnoser has two; None: what the baseline was trained with.

    Runs in a worker process. A window that the diagnoser refuses (a channel missing, a wrong unit)
    is not assessable.
    """
    judge = diagnoser_of_file(diagnoser, baseline)
    try:
        record = window.record()
        finding = (judge if method is None else judge.with_settings(method=method)).score(record)
        if "parameters" not in finding.evidence:
            return finding
        return replace(finding, evidence={**finding.evidence, "conditions": conditions(record)})
    except BadInput as error:
        return Finding.not_assessable(diagnoser, str(error))


def conditions(record: Record) -> dict[str, Any]:
    """Mean and unit of every signal of a window: what a value may be found to move with over many
    windows.
    """
    means = {
        name: float(np.nanmean(values))
        for name, values in record.channels.items()
        if not np.isnan(values).all()
    }
    return {name: {"mean": mean, "unit": record.units[name]} for name, mean in means.items()}
