"""Wiring: which simulated machine sends which stream over which bus."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from residuum.identification.errors import BadInput
from residuum.nearest_names import known_names


@dataclass(frozen=True)
class Wiring:
    """How one device is connected.

    Parameters
    ----------
    machine : str
        Name in the list of simulated machines.
    dbc, registers : str
        Bus descriptions that come with Residuum; empty when the device has no such bus.
    messages : mapping of the machine's stream to CAN message
    register_streams : mapping of the machine's stream to stream of the register map
    """

    machine: str
    dbc: str = ""
    registers: str = ""
    messages: Mapping[str, str] = field(default_factory=dict)
    register_streams: Mapping[str, str] = field(default_factory=dict)


WIRINGS: dict[str, Wiring] = {
    "gate-actuator": Wiring(
        "gate-actuator", dbc="gate_actuator.dbc", messages={"signals": "drive"}
    ),
    "gripping-pliers": Wiring(
        "gripping-pliers",
        dbc="gripping_pliers.dbc",
        registers="gripping_pliers.yaml",
        messages={"vibration": "vibration", "machine": "machine"},
        register_streams={"machine": "machine"},
    ),
    "process-plant": Wiring(
        "process", registers="process_plant.yaml", register_streams={"signals": "process"}
    ),
}
"""Devices by the name they have in the demo."""


def wiring_of(device: str) -> Wiring:
    """The wiring of a device (`process` is `process-plant`); BadInput lists what there is."""
    name = "process-plant" if device == "process" else device
    if name not in WIRINGS:
        raise BadInput(
            f"machine {device!r}: there is none of this name on a bus;"
            f" {known_names(device, WIRINGS)}"
        )
    return WIRINGS[name]
