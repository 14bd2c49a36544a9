"""By which of its variables an FMU gives directional derivatives that are right."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.physics.fmu.instance import Instance

Move = Callable[[FloatArray, float], None]
"""Bring the FMU to a point, one variable moved by so much."""

_STEP = 1e-6
_POINTS = 4
_AGREES = 1e-3
"""Points at which a derivative is held against a difference, and the part by which it may differ."""


def differentiated(instance: Instance, start: FloatArray, asked: Sequence[str]) -> set[str]:
    """Of states, inputs and the parameters asked for, those whose derivatives agree with
    differences of rates and outputs.

    FMI 2.0 promises them by states and inputs alone; an FMU that has them by parameters shows it by
    giving them. Where nothing moved at any point, zeros are not believed.
    """
    described = instance.description
    if described.exchange is None or not described.exchange.differentiates:
        return set()
    rng = np.random.default_rng(0)
    points = [start + rng.normal(size=start.size) for _ in range(_POINTS)]
    right = {
        name
        for name, reference, step, move in _moves(instance, start.size, asked)
        if _is_right(instance, reference, step, move, points)
    }
    instance.begin({})
    return right


def _moves(
    instance: Instance, size: int, asked: Sequence[str]
) -> Iterator[tuple[str, int, float, Move]]:
    """Name, reference, step and how to move each of the variables."""
    described = instance.description

    def of_point(k: int) -> Move:
        return lambda point, by: instance.place(point + by * (np.arange(size) == k))

    def of_parameter(name: str) -> Move:
        def move(point: FloatArray, by: float) -> None:
            instance.begin({name: described.parameters[name].start + by})
            instance.place(point)

        return move

    for k, variable in enumerate((*described.states, *described.inputs)):
        yield variable.name, variable.reference, _STEP, of_point(k)
    for name in asked:
        parameter = described.parameters[name]
        size_of_it = max(abs(parameter.start), parameter.nominal or 0.0, _STEP)
        yield name, parameter.reference, _STEP * size_of_it, of_parameter(name)


def _is_right(
    instance: Instance, reference: int, step: float, move: Move, points: Sequence[FloatArray]
) -> bool:
    moved = False
    for point in points:
        try:
            move(point, 0.0)
            given = instance.derivative(reference)
            move(point, step)
            high = instance.answer()
            move(point, -step)
            slope = (high - instance.answer()) / (2.0 * step)
        except Exception:
            # fmpy raises for any status that is an error: it has no such derivative
            return False
        size = float(np.linalg.norm(slope))
        if not np.linalg.norm(given - slope) <= _AGREES * size + _STEP:
            return False
        moved = moved or size > _STEP
    return moved
