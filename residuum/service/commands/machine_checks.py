"""What a machine of the settings lacks: signals, a model, a baseline; each with what to do about
it.
"""

from __future__ import annotations

from collections.abc import Mapping

from residuum.diagnosis.diagnosers import DIAGNOSERS
from residuum.identification.errors import BadInput
from residuum.identification.physics import load_model
from residuum.identification.units import compatible
from residuum.nearest_names import known_names
from residuum.service.alarms.alarm_states import AlarmRule
from residuum.service.alarms.machine_states import unknown_states
from residuum.service.fieldbus import SOURCES
from residuum.service.fieldbus.settings import MachineSettings
from residuum.service.machines.adding import guessed_channels, model_signals
from residuum.service.machines.machine_line import MachineLine

ENOUGH = 20
"""Healthy windows that a baseline should be trained from."""


def bus_signals(machine: MachineSettings) -> dict[str, str]:
    """Name and unit of every signal on the machine's buses; BadInput for a description that cannot
    be read.
    """
    sources = [SOURCES[source.kind](source, lambda _: True) for source in machine.sources]
    return {
        name: unit
        for source in sources
        for stream in source.streams
        for name, unit in stream.units.items()
    }


def machine_check(
    machine: MachineSettings, baseline: tuple[bool, int] | None, of_service: AlarmRule
) -> tuple[str, list[str], str]:
    """What a machine has, in a sentence, what it lacks, a sentence each, and a remark, empty for
    none.

    Parameters
    ----------
    baseline : (bool, int) or None
        Whether it has a baseline, and the number of recorded windows; None where the service has
        not run yet.
    of_service : AlarmRule
        The rule of alarms of machines that have none of their own.
    """
    try:
        # Made for its checks alone: it refuses settings that do not fit together.
        line = MachineLine(machine, lambda *_: lambda: None, lambda _: None)
        bus = bus_signals(machine)
    except BadInput as error:
        return "", [str(error)], ""
    lacks = (
        []
        if machine.diagnoser in DIAGNOSERS
        else [f"diagnoser {machine.diagnoser!r}: {known_names(machine.diagnoser, DIAGNOSERS)}"]
    )
    if machine.diagnoser == "model-based":
        lacks += _model_lacks(machine, bus)
    untold = unknown_states(machine.alarm_rule(of_service), line.units)
    remark = f"alarms, suppress: {'; '.join(untold)}" if untold else ""
    return f"reads {', '.join(bus)}; {_state(machine, baseline)}", lacks, remark


def _model_lacks(machine: MachineSettings, bus: Mapping[str, str]) -> list[str]:
    if machine.model is None:
        return ["model: is missing; name the machine's model file (docs: how to write a model)"]
    try:
        model = load_model(machine.model)
    except BadInput as error:
        return [f"model: {error}"]
    # Guesses are told and not taken: a signal of the same unit may be another one.
    guesses, lacks = guessed_channels(model, bus), []
    output_on_bus = False
    for name, (unit, role, needed) in model_signals(model).items():
        channel = machine.channels.get(name, name)
        if channel not in bus:
            if needed:
                lacks.append(_not_on_bus(name, role, bus, guesses))
        elif not compatible(bus[channel], unit):
            lacks.append(
                f"channels, {name}: the model has it in {unit}, the bus has {channel} in"
                f" {bus[channel] or 'no unit'}"
            )
        else:
            output_on_bus |= role == "output"
    # A single output may be missing, not all of them: a model is judged by its outputs.
    if not output_on_bus:
        lacks.append(
            f"channels: none of the model's outputs is on the bus ({', '.join(model.outputs)}); map"
            " at least one"
        )
    return lacks


def _not_on_bus(name: str, role: str, bus: Mapping[str, str], guesses: Mapping[str, str]) -> str:
    hint = known_names(name, bus, "the bus has")
    if name in guesses:
        hint = f"perhaps it is {guesses[name]}"
    return (
        f"channels, {name}: the model needs this {role}, the bus has no signal of this name; {hint}"
    )


def _state(machine: MachineSettings, baseline: tuple[bool, int] | None) -> str:
    if baseline is None:
        return "the service has not run yet"
    trained, count = baseline
    if trained:
        return "has a baseline"
    then = (
        f"train with: residuum watch train {machine.asset}"
        if count >= ENOUGH
        else f"let it run until there are {ENOUGH}"
    )
    return f"has no baseline yet, {count} windows recorded; {then}"
