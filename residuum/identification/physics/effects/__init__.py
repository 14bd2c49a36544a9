"""The catalogue of physical effects: id → effect. A new effect is one file here and one line in `EFFECTS`."""

from collections.abc import Mapping
from types import MappingProxyType

from residuum.identification.entry_points import from_entry_points
from residuum.identification.physics.effects.base import Effect
from residuum.identification.physics.effects.catalogue import EffectCatalogue
from residuum.identification.physics.effects.electric.brush_drop import BrushDrop
from residuum.identification.physics.effects.electric.inductance import Inductance
from residuum.identification.physics.effects.electric.resistance_heating import ResistanceHeating
from residuum.identification.physics.effects.electric.supply_sag import SupplySag
from residuum.identification.physics.effects.friction.coulomb_friction import CoulombFriction
from residuum.identification.physics.effects.friction.directional_friction import DirectionalFriction
from residuum.identification.physics.effects.friction.directional_viscous import DirectionalViscous
from residuum.identification.physics.effects.friction.load_friction import LoadFriction
from residuum.identification.physics.effects.friction.lugre import LuGre
from residuum.identification.physics.effects.friction.place_friction import PlaceFriction
from residuum.identification.physics.effects.friction.quadratic_drag import QuadraticDrag
from residuum.identification.physics.effects.friction.stribeck_friction import StribeckFriction
from residuum.identification.physics.effects.friction.viscous_friction import ViscousFriction
from residuum.identification.physics.effects.hydraulic.check_valve import CheckValve
from residuum.identification.physics.effects.hydraulic.leak import Leak
from residuum.identification.physics.effects.hydraulic.orifice import Orifice
from residuum.identification.physics.effects.hydraulic.outflow import Outflow
from residuum.identification.physics.effects.hydraulic.overflow import Overflow
from residuum.identification.physics.effects.hydraulic.pump_nonlinearity import PumpNonlinearity
from residuum.identification.physics.effects.load.bouc_wen import BoucWen
from residuum.identification.physics.effects.load.cogging import Cogging
from residuum.identification.physics.effects.load.constant_load import ConstantLoad
from residuum.identification.physics.effects.load.cubic_spring import CubicSpring
from residuum.identification.physics.effects.load.hysteresis import Hysteresis
from residuum.identification.physics.effects.load.linear_spring import LinearSpring
from residuum.identification.physics.effects.load.position_load import PositionLoad
from residuum.identification.physics.effects.load.tooth_ripple import ToothRipple
from residuum.identification.physics.effects.path.input_backlash import InputBacklash
from residuum.identification.physics.effects.path.input_dead_zone import InputDeadZone
from residuum.identification.physics.effects.path.input_delay import InputDelay
from residuum.identification.physics.effects.path.input_lag import InputLag
from residuum.identification.physics.effects.path.input_offset import InputOffset
from residuum.identification.physics.effects.path.input_power import InputPower
from residuum.identification.physics.effects.path.input_saturation import InputSaturation
from residuum.identification.physics.effects.path.output_absolute import OutputAbsolute
from residuum.identification.physics.effects.path.output_drift import OutputDrift
from residuum.identification.physics.effects.path.output_gain_curve import OutputGainCurve
from residuum.identification.physics.effects.path.output_lag import OutputLag
from residuum.identification.physics.effects.path.output_offset import OutputOffset
from residuum.identification.physics.effects.path.output_quantisation import OutputQuantisation
from residuum.identification.physics.effects.path.output_saturation import OutputSaturation
from residuum.identification.physics.effects.structure.coupling import Coupling
from residuum.identification.physics.effects.structure.forgotten_input import ForgottenInput
from residuum.identification.physics.effects.structure.learned import Learned
from residuum.identification.physics.effects.thermal.ambient_loss import AmbientLoss
from residuum.identification.physics.effects.thermal.constant_heat import ConstantHeat
from residuum.identification.physics.effects.thermal.convection import Convection
from residuum.identification.physics.effects.thermal.conveyor_load import ConveyorLoad
from residuum.identification.physics.effects.thermal.door_opening import DoorOpening
from residuum.identification.physics.effects.thermal.heater_nonlinearity import HeaterNonlinearity
from residuum.identification.physics.effects.thermal.radiation import Radiation
from residuum.identification.physics.effects.thermal.second_heat_store import SecondHeatStore
from residuum.identification.physics.effects.transmission.backlash import Backlash
from residuum.identification.physics.effects.transmission.elastic_transmission import ElasticTransmission
from residuum.identification.physics.effects.transmission.end_stop import EndStop

EFFECTS = EffectCatalogue(
    {
        "viscous-friction": ViscousFriction(),
        "coulomb-friction": CoulombFriction(),
        "stribeck-friction": StribeckFriction(),
        "lugre": LuGre(),
        "directional-friction": DirectionalFriction(),
        "directional-viscous": DirectionalViscous(),
        "load-friction": LoadFriction(),
        "place-friction": PlaceFriction(),
        "quadratic-drag": QuadraticDrag(),
        "constant-load": ConstantLoad(),
        "position-load": PositionLoad(),
        "tooth-ripple": ToothRipple(),
        "cogging": Cogging(),
        "linear-spring": LinearSpring(),
        "cubic-spring": CubicSpring(),
        "elastic-transmission": ElasticTransmission(),
        "backlash": Backlash(),
        "end-stop": EndStop(),
        "hysteresis": Hysteresis(),
        "bouc-wen": BoucWen(),
        "inductance": Inductance(),
        "brush-drop": BrushDrop(),
        "supply-sag": SupplySag(),
        "resistance-heating": ResistanceHeating(),
        "ambient-loss": AmbientLoss(),
        "constant-heat": ConstantHeat(),
        "radiation": Radiation(),
        "convection": Convection(),
        "second-heat-store": SecondHeatStore(),
        "conveyor-load": ConveyorLoad(),
        "door-opening": DoorOpening(),
        "heater-nonlinearity": HeaterNonlinearity(),
        "outflow": Outflow(),
        "orifice": Orifice(),
        "overflow": Overflow(),
        "check-valve": CheckValve(),
        "leak": Leak(),
        "pump-nonlinearity": PumpNonlinearity(),
        "input-delay": InputDelay(),
        "input-lag": InputLag(),
        "input-dead-zone": InputDeadZone(),
        "input-power": InputPower(),
        "input-saturation": InputSaturation(),
        "input-backlash": InputBacklash(),
        "input-offset": InputOffset(),
        "output-lag": OutputLag(),
        "output-drift": OutputDrift(),
        "output-offset": OutputOffset(),
        "output-saturation": OutputSaturation(),
        "output-absolute": OutputAbsolute(),
        "output-gain-curve": OutputGainCurve(),
        "output-quantisation": OutputQuantisation(),
    }
)
"""The catalogue; `EFFECTS.add` puts an effect of a user's own beside those of the list."""
STRUCTURAL: Mapping[str, Effect] = MappingProxyType(
    {"forgotten-input": ForgottenInput(), "coupling": Coupling(), "learned": Learned()}
)
"""Effects at `balance(signal)` or `balance(other)`: what they are tied to is searched in the records, not in the catalogue."""
for _found in from_entry_points("residuum.effects"):
    EFFECTS.add(_found() if isinstance(_found, type) else _found)
