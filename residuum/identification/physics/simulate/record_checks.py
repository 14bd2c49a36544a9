"""What records say against a model before it is simulated: that they begin elsewhere than its
`initial:`, or leave the range of its tables, whose first or last value then holds.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from residuum.identification.physics.files.expression import Call, Name, Number, evaluate, walk
from residuum.identification.physics.simulate.experiment import Experiment

if TYPE_CHECKING:
    from residuum.identification.physics.model import PhysicalModel

_BEGINNING = 5
"""[samples] Whose median is where a record begins: one outlier is none."""
_NOISE = 6.0
"""Times the noise by which it must differ. Chosen."""
_SPAN = 0.02
"""And part of the output's span: what is less changes no answer. Chosen."""
_LOOKED_AT = 1000
"""Samples of a record, evenly, besides those where what is looked up is made of an extreme
value.
"""


def leaves_tables(model: PhysicalModel, experiments: Sequence[Experiment]) -> tuple[str, ...]:
    """A sentence for each table that a record leaves: how far, for which part of it.

    What is looked up is computed from the inputs and the outputs that show a state alone, as they
    were measured; of a table of a state that was not measured nothing is said.
    """
    nodes = (node for e in model.expressions for node in walk(e.tree))
    tables = {
        n: _looked_up(n) for n in nodes if isinstance(n, Call) and n.function in ("table", "cubic")
    }
    sentences: dict[str, str] = {}
    for node, text in tables.items():
        low, high = _ends(node)
        for experiment in experiments:
            looked_up = np.array(list(_along(node, model, experiment)))
            outside = (looked_up < low) | (looked_up > high)
            if outside.any() and text not in sentences:
                least = np.nanmin(looked_up)
                most = np.nanmax(looked_up)
                span = f"{least:.4g} to {most:.4g}, which is there from {low:g} to {high:g}"
                sentences[text] = (
                    f"table: {experiment.source or 'the record'} leads {text} from {span}; its end"
                    f" values hold beyond ({100 * np.mean(outside):.2g} % of the record)"
                )
    return tuple(sentences.values())


def _looked_up(node: Call) -> str:
    """What a table looks up, by the names that it is made of."""
    return " with ".join(sorted({n.name for n in walk(node.operands[0]) if isinstance(n, Name)}))


def _ends(node: Call) -> tuple[float, float]:
    places = [
        n.value for n in node.operands[1 : 1 + len(node.operands) // 2] if isinstance(n, Number)
    ]
    return places[0], places[-1]


def _along(node: Call, model: PhysicalModel, experiment: Experiment) -> Iterator[float]:
    first = node.operands[0]
    names = {n.name for n in walk(first) if isinstance(n, Name)} - model.parameters.keys()
    columns = {
        name: values for name in names if (values := _measured(name, model, experiment)) is not None
    }
    # A name that nothing shows, or none at all: nothing to look up along the record.
    if names - columns.keys() or not names:
        return
    samples = set(
        np.linspace(0, experiment.n - 1, min(experiment.n, _LOOKED_AT)).astype(int).tolist()
    )
    for values in columns.values():
        if np.isfinite(values).any():
            # Extremes leave a table first.
            samples |= {int(np.nanargmin(values)), int(np.nanargmax(values))}
    for k in sorted(samples):
        yield evaluate(
            first, {**model.values, **{name: float(values[k]) for name, values in columns.items()}}
        )


def _measured(
    name: str, model: PhysicalModel, experiment: Experiment
) -> npt.NDArray[np.float64] | None:
    if name in model.inputs:
        return experiment.U[:, list(model.inputs).index(name)]
    for number, output in enumerate(model.outputs.values()):
        if isinstance(output.value.tree, Name) and output.value.tree.name == name:
            return experiment.Y[:, number]
    return None


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
        # A record that begins with a hole says nothing of its first value.
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
