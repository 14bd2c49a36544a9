"""Simulated movements of gate actuators, healthy and with each fault, with the features of the source and ours."""

from dataclasses import dataclass

from residuum.diagnosis.gate.actuator_model import ActuatorConstants
from residuum.diagnosis.gate.movement_features import RATE, MovementFeatures, movement_features
from residuum.diagnosis.gate.movements import Movement, cut_movements
from residuum.diagnosis.residuals.fault_isolation import HEALTHY, PINION_OR_GEAR, RACK
from residuum.identification.record import Record
from residuum.simulation import MACHINES

CONDITIONS = {  # fault: (class, movements an exemplar); together 130, 90, 40, as the source's 131, 92, 37
    None: (HEALTHY, 13),
    "gear-notch": (PINION_OR_GEAR, 5),
    "pinion-tooth": (PINION_OR_GEAR, 4),
    "rack-tooth": (RACK, 4),
}
GRADE_9 = 0.3
"""`tooth_errors` of gears that hold ISO 1328-1 grade 9, as moulded nylon and cut steel do (docstring of the simulator)."""
CLASSES = (HEALTHY, PINION_OR_GEAR, RACK)
CONSTANTS = ActuatorConstants()
# s: a movement with its pause, and what is added so that the last one ends
PERIOD, PAUSE = (19.5, 8.0)


@dataclass(frozen=True)
class Observed:
    """One simulated movement with its exemplar, its fault (None: healthy) and its features."""

    exemplar: int
    fault: str | None
    movement: Movement
    features: MovementFeatures

    @property
    def label(self) -> str:
        """The class of its fault."""
        return CONDITIONS[self.fault][0]


def observe(exemplar: int, fault: str | None, tooth_errors: float = GRADE_9) -> list[Observed]:
    """The first movements of an exemplar's life with a fault of its default size."""
    count = CONDITIONS[fault][1]
    machine = MACHINES["gate-actuator"](
        seed=1000 + exemplar,
        exemplar=exemplar,
        faults={fault: None} if fault else {},
        tooth_errors=tooth_errors,
    )
    signals = machine.simulate(count * PERIOD + PAUSE)
    movements = cut_movements(Record(signals.channels, signals.units, signals.sample_time))[:count]
    return [
        Observed(exemplar, fault, movement.reduced(RATE), movement_features(movement, CONSTANTS))
        for movement in movements
    ]
