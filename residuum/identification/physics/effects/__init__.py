"""The catalogue of physical effects: id → effect. A new effect is one file here and one line in `EFFECTS`."""

from collections.abc import Mapping
from types import MappingProxyType

from residuum.identification.physics.effects.ambient_loss import AmbientLoss
from residuum.identification.physics.effects.backlash import Backlash
from residuum.identification.physics.effects.base import Effect
from residuum.identification.physics.effects.brush_drop import BrushDrop
from residuum.identification.physics.effects.constant_load import ConstantLoad
from residuum.identification.physics.effects.conveyor_load import ConveyorLoad
from residuum.identification.physics.effects.coulomb_friction import CoulombFriction
from residuum.identification.physics.effects.cubic_spring import CubicSpring
from residuum.identification.physics.effects.directional_friction import DirectionalFriction
from residuum.identification.physics.effects.door_opening import DoorOpening
from residuum.identification.physics.effects.drifting_load import DriftingLoad
from residuum.identification.physics.effects.elastic_transmission import ElasticTransmission
from residuum.identification.physics.effects.end_stop import EndStop
from residuum.identification.physics.effects.heater_nonlinearity import HeaterNonlinearity
from residuum.identification.physics.effects.hysteresis import Hysteresis
from residuum.identification.physics.effects.inductance import Inductance
from residuum.identification.physics.effects.input_dead_zone import InputDeadZone
from residuum.identification.physics.effects.input_delay import InputDelay
from residuum.identification.physics.effects.input_offset import InputOffset
from residuum.identification.physics.effects.input_saturation import InputSaturation
from residuum.identification.physics.effects.leak import Leak
from residuum.identification.physics.effects.linear_spring import LinearSpring
from residuum.identification.physics.effects.load_friction import LoadFriction
from residuum.identification.physics.effects.outflow import Outflow
from residuum.identification.physics.effects.output_absolute import OutputAbsolute
from residuum.identification.physics.effects.output_lag import OutputLag
from residuum.identification.physics.effects.output_offset import OutputOffset
from residuum.identification.physics.effects.output_quantisation import OutputQuantisation
from residuum.identification.physics.effects.overflow import Overflow
from residuum.identification.physics.effects.position_load import PositionLoad
from residuum.identification.physics.effects.pump_nonlinearity import PumpNonlinearity
from residuum.identification.physics.effects.quadratic_drag import QuadraticDrag
from residuum.identification.physics.effects.radiation import Radiation
from residuum.identification.physics.effects.resistance_heating import ResistanceHeating
from residuum.identification.physics.effects.second_heat_store import SecondHeatStore
from residuum.identification.physics.effects.stribeck_friction import StribeckFriction
from residuum.identification.physics.effects.supply_sag import SupplySag
from residuum.identification.physics.effects.tooth_ripple import ToothRipple
from residuum.identification.physics.effects.viscous_friction import ViscousFriction

EFFECTS: Mapping[str, Effect] = MappingProxyType(
    {
        "viscous-friction": ViscousFriction(),
        "coulomb-friction": CoulombFriction(),
        "stribeck-friction": StribeckFriction(),
        "directional-friction": DirectionalFriction(),
        "load-friction": LoadFriction(),
        "quadratic-drag": QuadraticDrag(),
        "constant-load": ConstantLoad(),
        "position-load": PositionLoad(),
        "tooth-ripple": ToothRipple(),
        "linear-spring": LinearSpring(),
        "cubic-spring": CubicSpring(),
        "elastic-transmission": ElasticTransmission(),
        "backlash": Backlash(),
        "end-stop": EndStop(),
        "hysteresis": Hysteresis(),
        "inductance": Inductance(),
        "brush-drop": BrushDrop(),
        "supply-sag": SupplySag(),
        "resistance-heating": ResistanceHeating(),
        "ambient-loss": AmbientLoss(),
        "radiation": Radiation(),
        "second-heat-store": SecondHeatStore(),
        "conveyor-load": ConveyorLoad(),
        "door-opening": DoorOpening(),
        "heater-nonlinearity": HeaterNonlinearity(),
        "outflow": Outflow(),
        "overflow": Overflow(),
        "leak": Leak(),
        "pump-nonlinearity": PumpNonlinearity(),
        "input-delay": InputDelay(),
        "input-dead-zone": InputDeadZone(),
        "input-saturation": InputSaturation(),
        "input-offset": InputOffset(),
        "output-lag": OutputLag(),
        "output-offset": OutputOffset(),
        "output-absolute": OutputAbsolute(),
        "output-quantisation": OutputQuantisation(),
    }
)
UNNAMED: Mapping[str, Effect] = MappingProxyType({"drifting-load": DriftingLoad()})
"""What stands in a model only while it is judged, beside the catalogue: effects that name no physics."""
