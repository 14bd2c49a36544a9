"""The signals of a model along which its error is looked at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.physics import Experiment, PhysicalModel, Simulator
from residuum.identification.record import Record
from residuum.identification.residual_analysis.places.locate import Axis
from residuum.identification.residual_analysis.policy.answers import STANDSTILL_SPEED
from residuum.identification.units import compatible


def signal_axes(model: PhysicalModel, experiment: Experiment, X: FloatArray, record: Record | None = None) -> list[Axis]:
    """Inputs, states, variables that balances define, recorded temperatures and time, as axes of one record.

    `X` are the states along which to look, shape (n, states), from a simulation or a smoother. A state or variable that
    is measured carries the name of its output.
    """
    roles = _roles(model)
    shown = {output.value.text.strip(): name for name, output in model.outputs.items()}
    axes = [
        Axis(name, signal.unit, roles.get(name, "input"), experiment.U[:, k])
        for k, (name, signal) in enumerate(model.inputs.items())
        if not signal.absent
    ]
    simulator = Simulator(model)
    for k, name in enumerate(simulator.states):
        unit = model.states[name].unit if name in model.states else ""
        axes.append(Axis(shown.get(name, name), unit, roles.get(name, "other"), X[:, k]))
    look = simulator.look(experiment, X)
    for balance in model.balances.values():
        if balance.defines is not None and balance.defines in look:
            name = balance.defines
            axes.append(Axis(shown.get(name, name), _unit_of_output(model, name), roles.get(name, "other"), look[name]))
    if record is not None:
        axes += _recorded_temperatures(record, {axis.name for axis in axes})
    axes.append(Axis("time", "s", "time", experiment.sample_time * np.arange(experiment.n, dtype=np.float64)))
    return axes


def direction_of_movement(axes: Sequence[Axis]) -> FloatArray | None:
    """Sign of the first velocity among the axes, zero near standstill; None without one."""
    velocity = next((axis.values for axis in axes if axis.kind == "velocity"), None)
    if velocity is None or not np.any(np.isfinite(velocity)):
        return None
    return np.asarray(np.where(np.abs(velocity) > STANDSTILL_SPEED * np.nanmax(np.abs(velocity)), np.sign(velocity), 0.0))


def _roles(model: PhysicalModel) -> Mapping[str, str]:
    kinds = {"ambient": "temperature"}
    return {name: kinds.get(role, role) for balance in model.balances.values() for role, name in balance.variables.items()}


def _unit_of_output(model: PhysicalModel, variable: str) -> str:
    units = [output.unit for output in model.outputs.values() if output.value.text.strip() == variable]
    return units[0] if units else {"current": "A"}.get(_roles(model).get(variable, ""), "")


def _recorded_temperatures(record: Record, known: set[str]) -> list[Axis]:
    found = [name for name in record.names if name not in known and record.units[name] and compatible(record.units[name], "K")]
    return [Axis(name, record.units[name], "temperature", np.asarray(record[name], dtype=float)) for name in found]
