"""Which signal of a bus a model means: the one of the same name, else the only one with a unit that can be converted."""

from __future__ import annotations

from collections.abc import Mapping

from residuum.identification.physics import PhysicalModel
from residuum.identification.units import compatible


def model_signals(model: PhysicalModel) -> dict[str, tuple[str, str, bool]]:
    """Every input and output of a model: its unit, `input` or `output`, and whether a machine must have it."""
    inputs = {name: (signal.unit, "input", signal.default is None) for name, signal in model.inputs.items()}
    return inputs | {name: (signal.unit, "output", False) for name, signal in model.outputs.items()}


def guessed_channels(model: PhysicalModel, bus: Mapping[str, str]) -> dict[str, str]:
    """Model's name of a signal → the bus's, where one is the obvious choice.

    Parameters
    ----------
    bus : mapping of name to unit
    """
    wanted = {name: unit for name, (unit, _, _) in model_signals(model).items()}
    lower = {name.lower(): name for name in bus}
    found = {name: lower[name.lower()] for name in wanted if name.lower() in lower}
    open_names = [name for name in wanted if name not in found]
    for name in open_names:
        left = _fitting({channel: unit for channel, unit in bus.items() if channel not in found.values()}, wanted[name])
        rivals = [other for other in open_names if other not in found and _fitting(left, wanted[other])]
        if len(left) == 1 and rivals == [name]:
            found[name] = next(iter(left))
    return found


def _fitting(bus: Mapping[str, str], unit: str) -> dict[str, str]:
    """The channels whose unit can be converted to this one."""
    return {channel: its for channel, its in bus.items() if compatible(its, unit)}
