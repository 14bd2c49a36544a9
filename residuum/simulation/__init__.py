"""Virtual machines with hidden effects and injectable faults; shares no code with the models it
tests.
"""

from residuum.simulation.gate_actuator import GateActuator
from residuum.simulation.gate_drive import GateDrive
from residuum.simulation.gripping_pliers import GrippingPliers
from residuum.simulation.linear_axis import LinearAxis
from residuum.simulation.machine import BadSetting, Machine
from residuum.simulation.oscillator import OscillatorMachine
from residuum.simulation.oven import OvenMachine
from residuum.simulation.process import Process
from residuum.simulation.signals import Signals
from residuum.simulation.two_tanks import TwoTanks

MACHINES: dict[str, type[Machine]] = {
    "gate-actuator": GateActuator,
    "gripping-pliers": GrippingPliers,
    "process": Process,
    "process-plant": Process,
    "gate-drive": GateDrive,
    "oven": OvenMachine,
    "linear-axis": LinearAxis,
    "oscillator": OscillatorMachine,
    "two-tanks": TwoTanks,
}

__all__ = ["MACHINES", "BadSetting", "Machine", "Signals"]
