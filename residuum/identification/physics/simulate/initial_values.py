"""Whether records begin where a model file's `initial:` says that its states do."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from residuum.identification.physics.files.expression import Name
from residuum.identification.physics.simulate.experiment import Experiment

if TYPE_CHECKING:
    from residuum.identification.physics.model import PhysicalModel

_BEGINNING = 5
"""[samples] Whose median is where a record begins: one outlier is none."""
_NOISE = 6.0
"""Times the noise by which it must differ. Chosen."""
_SPAN = 0.02
"""And part of the output's span: what is less changes no answer. Chosen."""


def begins_elsewhere(model: PhysicalModel, experiments: Sequence[Experiment]) -> tuple[str, ...]:
    """A sentence for each state whose fixed first value a record contradicts, with the way on.

    A state is read where an output is nothing but it: a value copied from a template is then held
    against the first samples. Of a state that no output shows alone nothing is said.
    """
    return tuple(
        f"initial: {state} is {model.initial[state]:g}{unit} in the model, and {record} begins at"
        f" {begin:.3g}{unit}; write initial: {{{state}: {begin:.3g}}}, or leave {state} out there:"
        " it is then estimated for each record"
        for state, column, unit in _shown(model)
        for record, begin in _first_that_differs(experiments, column, model.initial[state])
    )


def _shown(model: PhysicalModel) -> Iterator[tuple[str, int, str]]:
    """States with a fixed first value that an output shows alone: name, number of the output,
    unit.
    """
    for number, output in enumerate(model.outputs.values()):
        tree = output.value.tree
        if isinstance(tree, Name) and tree.name in model.initial:
            yield tree.name, number, f" {output.unit}" if output.unit else ""


def _first_that_differs(
    experiments: Sequence[Experiment], column: int, value: float
) -> Iterator[tuple[str, float]]:
    """The first record that does not begin at the value, and where it begins; nothing where all
    do.
    """
    for experiment in experiments:
        y = experiment.Y[:, column]
        known = y[np.isfinite(y)]
        if len(known) <= _BEGINNING or not np.isfinite(y[0]):
            continue
        begin = _begin(known[:_BEGINNING])
        # A fast state leaves its first value within a few samples: the first reading may speak for
        # the value, too.
        if min(abs(begin - value), abs(known[0] - value)) > max(
            _NOISE * _noise(known), _SPAN * float(np.ptp(known))
        ):
            yield experiment.source or "the record", begin
            return


def _begin(y: npt.NDArray[np.float64]) -> float:
    """Where first samples on a line begin, one outlier not counted: medians of the slopes, then of
    what they leave.
    """
    return float(np.median(y - np.median(np.diff(y)) * np.arange(len(y))))


def _noise(y: npt.NDArray[np.float64]) -> float:
    """Standard deviation of what second differences leave of a smooth signal, outliers not
    counted.
    """
    return float(1.4826 * np.median(np.abs(np.diff(y, 2))) / np.sqrt(6.0))
