"""Data at a lower rate that loses nothing."""

from __future__ import annotations

from dataclasses import replace

from residuum.identification.physics import Experiment
from residuum.identification.residual_analysis.input_timing import each_turned, turned_timing
from residuum.identification.residual_analysis.lower_rate import at_lower_rate
from residuum.identification.unseen_blocks.data import Data, data_of


def coarser(data: Data) -> Data:
    """The data at the lowest rate 1/2, 1/4, … of theirs that loses nothing and leaves enough samples, else themselves."""
    experiments, step = at_lower_rate(data.model, data.experiments)
    return data if step == 1 else replace(data_of(data.model, experiments), finer=data)


def turned(data: Data) -> Data:
    """The data at the other input timing: inputs that were held move evenly, and those that moved are held."""
    return _timed(data, turned_timing((data.finer or data).experiments))


def one_turned(data: Data) -> list[Data]:
    """The data with one of several inputs turned, each once."""
    return [_timed(data, experiments) for experiments in each_turned((data.finer or data).experiments)]


def _timed(data: Data, experiments: list[Experiment]) -> Data:
    records = data_of(data.model, experiments)
    return coarser(records) if data.finer else records
