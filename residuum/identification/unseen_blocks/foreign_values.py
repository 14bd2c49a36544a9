"""Parameters of what is foreign to a model (an FMU) as values that a search may doubt.

How the outputs answer a parameter θ, a = Δy/Δθ, is simulated along the records and written beside
their signals; the outputs of the model that is searched become y + (θ − θ₀) a, θ held at its value
θ₀. So a search frees it as any value that a model holds, and what is foreign is simulated no more for that.

Of many parameters those are taken whose slopes s resemble the errors e most: the score test, the
part (eᵀs)²/(eᵀe sᵀs) of the errors' power that a step of θ would take away, s without what first
states X

Reference: C. R. Rao, *Large sample tests of statistical hypotheses concerning several parameters*,
Proc. Camb. Phil. Soc. 44 (1948) 50.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from types import MappingProxyType

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.errors import NotIdentifiable
from residuum.identification.physics.effects.base import Parameter
from residuum.identification.physics.estimation.estimation import Estimate, estimate
from residuum.identification.physics.files.expression import (
    Expression,
    Name,
    Number,
    Operation,
    Place,
)
from residuum.identification.physics.model import Input, Output, PhysicalModel
from residuum.identification.physics.simulate.differences import Step, central
from residuum.identification.physics.simulate.experiment import Experiment
from residuum.identification.physics.simulate.simulation import Simulator
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.following import beside
from residuum.identification.unseen_blocks.policy import (
    ANSWER_STEP,
    FOREIGN_DOUBTED,
    FOREIGN_LOOKED_AT,
    HELD_REACH,
    RESEMBLES,
    SECANTS,
)


@dataclass(frozen=True, eq=False)
class Answer:
    """How the outputs answer a parameter along each experiment: `slopes` (n, outputs) in the unit
    of an output by the parameter's.
    """

    parameter: Parameter
    slopes: Sequence[FloatArray]


def answers(
    model: PhysicalModel, experiments: Sequence[Experiment], wanted: Sequence[str]
) -> list[Answer]:
    """Of the parameters that resemble the errors most, and of those that are `wanted`; none where
    it cannot be simulated along the experiments.
    """
    simulator = Simulator(model)
    try:
        begun = estimate(model, experiments, free=())
    except NotIdentifiable:
        return []

    def simulated(parameter: Parameter, value: float) -> FloatArray:
        p = simulator.p({parameter.name: value})
        return simulator.run_each(experiments, begun.initial, p, substeps=begun.substeps).Y

    def fitted(parameter: Parameter, value: float) -> FloatArray:
        """With first states of its own, or nothing where there are none."""
        moved = model.with_values({parameter.name: value})
        try:
            own = estimate(moved, experiments, free=())
        except NotIdentifiable:
            return np.full(score.weights.shape, np.nan)
        p = simulator.p({parameter.name: value})
        return simulator.run_each(experiments, own.initial, p, substeps=own.substeps).Y

    score = _ScoreTest.of(simulator, experiments, begun)
    scores = []
    for name in [*dict.fromkeys([*wanted, *model.parameters])][
        : max(FOREIGN_LOOKED_AT, len(wanted))
    ]:
        parameter = model.parameters[name]
        step = Step(ANSWER_STEP, abs(parameter.value)).of(parameter.value)
        slope = central(partial(simulated, parameter), parameter.value, step, _bounds(parameter))
        if np.isfinite(slope).all():
            scores.append((score.of_slope(slope)[0], parameter, slope))
    like = sorted((s[0] for s in scores if s[0] > RESEMBLES), reverse=True)[:FOREIGN_DOUBTED]
    found = []
    edges = np.cumsum([e.n for e in experiments])[:-1]
    for share, parameter, slope in scores:
        if share in like or parameter.name in wanted:
            answer = slope
            # Secants, each over the step that the one before asks for: where it ends it is right.
            for _ in range(SECANTS):
                step = score.of_slope(answer)[1]
                answer = _secant(partial(fitted, parameter), parameter, step, answer)
            found.append(Answer(parameter, np.split(answer, edges)))
    return found


def _secant(
    run: Callable[[float], FloatArray], parameter: Parameter, step: float, slope: FloatArray
) -> FloatArray:
    """The answer over a step, within what a search may reach, first states fitted at both its ends;
    the slope, where it has no end.
    """
    reach = HELD_REACH * abs(parameter.value)
    to = float(np.clip(parameter.value + np.clip(step, -reach, reach), *_bounds(parameter)))
    if to == parameter.value:
        return slope
    answer = (run(to) - run(parameter.value)) / (to - parameter.value)
    return answer if np.isfinite(answer).all() else slope


@dataclass(frozen=True, eq=False)
class _ScoreTest:
    """Errors e (rows · outputs,), the outputs in units of their own errors, and by experiment its
    rows and an orthonormal basis of what its first states answer for.
    """

    errors: FloatArray
    weights: FloatArray
    bases: Sequence[tuple[slice, FloatArray]]

    @classmethod
    def of(
        cls, simulator: Simulator, experiments: Sequence[Experiment], begun: Estimate
    ) -> _ScoreTest:
        """Along experiments at a model's own values, its first states fitted."""
        errors = np.concatenate(begun.residuals)
        known = np.isfinite(errors)
        size = np.sqrt(np.sum(np.where(known, errors, 0.0) ** 2, axis=0))
        # What was not measured, or is met exactly, counts nothing.
        weights = known * np.divide(1.0, size, out=np.zeros_like(size), where=size > 0.0)
        names = [f"initial:{name}" for name in simulator.free_states]
        runs = simulator.run_each(
            experiments, begun.initial, simulator.p(), slopes=names, substeps=begun.substeps
        )
        bases = []
        edges = np.cumsum([0, *(e.n for e in experiments)])
        for a, b in pairwise(edges.tolist()):
            slopes = np.zeros((b - a, len(size), 0)) if runs.dY is None else runs.dY[a:b]
            rows = slice(a * len(size), b * len(size))
            columns = np.nan_to_num(slopes * weights[a:b, :, None])
            columns = columns.reshape(rows.stop - rows.start, slopes.shape[2])
            bases.append((rows, np.linalg.qr(columns)[0]))
        return cls((np.nan_to_num(errors) * weights).ravel(), weights, bases)

    def of_slope(self, slope: FloatArray) -> tuple[float, float]:
        """Part of the errors' power that a step along slopes (rows, outputs) would take away, and
        that step.
        """
        s = (slope * self.weights).ravel()
        for rows, basis in self.bases:
            s[rows] = beside(basis, s[rows])
        along, power = float(self.errors @ s), float(s @ s)
        whole = float(self.errors @ self.errors)
        if not power * whole > 0.0:
            return 0.0, 0.0
        return along**2 / (power * whole), along / power


def _bounds(parameter: Parameter) -> tuple[float, float]:
    return parameter.lower, parameter.upper


def doubting(model: PhysicalModel, found: Sequence[Answer]) -> PhysicalModel:
    """The model whose outputs answer these parameters, held at their values."""
    parameters = {a.parameter.name: replace(a.parameter, fixed=True) for a in found}
    # With a default: no effect is sought on the path of a signal that nobody sent.
    inputs = {
        name: Input(name, "", default="0")
        for k in range(len(found))
        for name in _names(k, model.outputs)
    }
    outputs = {
        name: replace(output, value=_answering(output, o, list(model.outputs), found))
        for o, (name, output) in enumerate(model.outputs.items())
    }
    return replace(
        model,
        inputs=MappingProxyType({**model.inputs, **inputs}),
        parameters=MappingProxyType({**model.parameters, **parameters}),
        outputs=MappingProxyType(outputs),
    )


def _names(k: int, outputs: Mapping[str, Output] | Sequence[str]) -> list[str]:
    """Of the signals that say how each output answers the parameter of this number."""
    return [f"fmu_answer_{k}_{output}" for output in outputs]


def _answering(
    output: Output, o: int, outputs: Sequence[str], found: Sequence[Answer]
) -> Expression:
    """The output's expression with (θ − θ₀) ∂y/∂θ added for each parameter."""
    value, place = output.value, Place(output.name)
    tree, text = value.tree, value.text
    for k, answer in enumerate(found):
        name, held = answer.parameter.name, answer.parameter.value
        signal = _names(k, outputs)[o]
        change = Operation("-", (Name(name, place), Number(held, place)), place)
        term = Operation("*", (change, Name(signal, place)), place)
        tree = Operation("+", (tree, term), place)
        text += f" + ({name} - {held!r}) * {signal}"
    return Expression(text, tree, value.where)


def with_answers(
    records: Sequence[Record], model: PhysicalModel, found: Sequence[Answer]
) -> list[Record]:
    """The records with the signals that say how the model's outputs answer, one a parameter and
    output.
    """
    told = []
    for number, record in enumerate(records):
        signals = {
            name: answer.slopes[number][:, o]
            for k, answer in enumerate(found)
            for o, name in enumerate(_names(k, model.outputs))
        }
        told.append(
            replace(
                record,
                channels={**record.channels, **signals},
                units={**record.units, **dict.fromkeys(signals, "")},
            )
        )
    return told
