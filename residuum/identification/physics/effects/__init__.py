"""The catalogue of physical effects: id → effect. A new effect is one class in the file of its kind
and one line in `EFFECTS`.
"""

from __future__ import annotations

import hashlib
import inspect
import re
import uuid
from collections.abc import Iterator, Mapping
from contextvars import ContextVar
from types import MappingProxyType

from residuum.identification.entry_points import from_entry_points
from residuum.identification.errors import BadModel
from residuum.identification.physics.effects.base import Effect
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
)
from residuum.identification.physics.effects.input_path import (
    HeaterNonlinearity,
    InputBacklash,
    InputDeadZone,
    InputDelay,
    InputLag,
    InputOffset,
    InputPower,
    InputSaturation,
    PumpNonlinearity,
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
    Radiation,
    SecondHeatStore,
)
from residuum.identification.physics.effects.transmission import (
    Backlash,
    ElasticTransmission,
    EndStop,
)

_ID = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
_DECLARED = ("title", "equation", "reference", "acts_on")


class EffectCatalogue(Mapping[str, Effect]):
    """Effects by id, in the order of the list; then those that were added, and those that a file
    defines for the work at hand.
    """

    def __init__(self, listed: Mapping[str, Effect]) -> None:
        self._listed = dict(listed)
        self._added = dict[str, Effect]()
        self._fingerprints: dict[str, str] = {}
        # Of a context: two requests of one service may each bring a file that defines an effect of
        # one id.
        self._here: ContextVar[Mapping[str, Effect]] = ContextVar(
            "effects of this work", default=MappingProxyType({})
        )

    def __getitem__(self, id: str) -> Effect:
        if id in self._listed:
            return self._listed[id]
        local = self._here.get()
        # A file for the work at hand before what was added for all.
        return local[id] if id in local else self._added[id]

    def __iter__(self) -> Iterator[str]:
        yield from self._listed
        # One id once, though it was added and stands in a file as well.
        yield from {**self._added, **self._here.get()}

    def __len__(self) -> int:
        return len(self._listed) + len({**self._added, **self._here.get()})

    def use_here(self, *effects: Effect) -> None:
        """Put effects that a file defines into the catalogue of this context alone: of this
        command, request or job.

        Raises
        ------
        BadModel
            An id of the list.
        """
        if taken := [effect.id for effect in effects if effect.id in self._listed]:
            raise BadModel(f"effect {taken[0]!r}: the catalogue has one of this id; choose another")
        # A new mapping: contexts that were copied from this one keep theirs.
        self._here.set(
            MappingProxyType({**self._here.get(), **{effect.id: effect for effect in effects}})
        )

    def add(self, effect: Effect) -> None:
        """Put an effect of a user's own into the catalogue; an added one of the same id is
        replaced.

        Raises
        ------
        BadModel
            What is no effect, an id of the list, one that is not of small letters, digits and `-`,
            or a class attribute that is missing.
        """
        if not isinstance(effect, Effect):
            raise BadModel(
                f"effect: is {type(effect).__name__}; must be an Effect, or a class of one"
            )
        id = getattr(effect, "id", "")
        if not _ID.fullmatch(id):
            raise BadModel(
                f"effect {type(effect).__name__}: id is {id!r}; must be small letters, digits"
                " and '-'"
            )
        if id in self._listed:
            raise BadModel(f"effect {id!r}: the catalogue has one of this id; choose another")
        if missing := [name for name in _DECLARED if not hasattr(effect, name)]:
            raise BadModel(f"effect {id!r}: class attribute {missing[0]!r} is missing")
        self._added[id] = effect
        self._fingerprints[id] = _digest(effect)

    def is_here(self, id: str) -> bool:
        """Whether a file defines the effect for the work at hand."""
        return id in self._here.get()

    def fingerprint(self, id: str) -> str:
        """What tells added effects of one id apart in kernels that are kept on disk; empty for
        those of the list.
        """
        local = self._here.get()
        return _digest(local[id]) if id in local else self._fingerprints.get(id, "")


def _digest(effect: Effect) -> str:
    """Of what a file defines, or of the class's source; another one in every process where the
    source cannot be seen.
    """
    if (definition := getattr(effect, "definition", None)) is not None:
        return hashlib.sha256(repr(definition).encode()).hexdigest()[:16]
    try:
        # Values of its attributes too: two objects of one class may have other equations.
        source = inspect.getsource(type(effect)) + repr(sorted(vars(effect).items()))
    except (OSError, TypeError):
        # Typed into a console: its code cannot be read, so no kernel of another process is trusted.
        source = uuid.uuid4().hex
    return hashlib.sha256(source.encode()).hexdigest()[:16]


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
# Effects of installed packages, by their entry points.
for _registered in from_entry_points("residuum.effects"):
    EFFECTS.add(_registered() if isinstance(_registered, type) else _registered)
