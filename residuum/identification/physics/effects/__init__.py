"""The catalogue of physical effects: id → effect. A new effect is one class in the file of its kind
and one line in `EFFECTS`.
"""

from collections.abc import Mapping
from types import MappingProxyType

from residuum.identification.entry_points import from_entry_points
from residuum.identification.physics.effects.base import Effect
from residuum.identification.physics.effects.catalogue import EffectCatalogue
from residuum.identification.physics.effects.electric import (
    BrushDrop,
    Inductance,
    ResistanceHeating,
    SupplySag,
)
from residuum.identification.physics.effects.friction import (
    CoulombFriction,
    DirectionalFriction,
    DirectionalViscous,
    LoadFriction,
    LuGre,
    PlaceFriction,
    QuadraticDrag,
    StribeckFriction,
    ViscousFriction,
)
from residuum.identification.physics.effects.hydraulic import (
    CheckValve,
    Leak,
    Orifice,
    Outflow,
    Overflow,
    PumpNonlinearity,
)
from residuum.identification.physics.effects.input_path import (
    InputBacklash,
    InputDeadZone,
    InputDelay,
    InputLag,
    InputOffset,
    InputPower,
    InputSaturation,
)
from residuum.identification.physics.effects.load import (
    Cogging,
    ConstantLoad,
    PositionLoad,
    ToothRipple,
)
from residuum.identification.physics.effects.output_path import (
    OutputAbsolute,
    OutputDrift,
    OutputGainCurve,
    OutputLag,
    OutputOffset,
    OutputQuantisation,
    OutputSaturation,
)
from residuum.identification.physics.effects.spring import (
    BoucWen,
    CubicSpring,
    Hysteresis,
    LinearSpring,
)
from residuum.identification.physics.effects.structure import Coupling, ForgottenInput, Learned
from residuum.identification.physics.effects.thermal import (
    AmbientLoss,
    ConstantHeat,
    Convection,
    ConveyorLoad,
    DoorOpening,
    HeaterNonlinearity,
    Radiation,
    SecondHeatStore,
)
from residuum.identification.physics.effects.transmission import (
    Backlash,
    ElasticTransmission,
    EndStop,
)

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
"""Effects at `balance(signal)` or `balance(other)`: what they are tied to is searched in the
records, not in the catalogue.
"""
for _found in from_entry_points("residuum.effects"):
    EFFECTS.add(_found() if isinstance(_found, type) else _found)
