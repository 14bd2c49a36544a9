"""The diagnosers, one file each, by the name that the command line and the interface use."""

import inspect
from typing import Any

from residuum.diagnosis.diagnosers.base import Diagnoser
from residuum.identification.entry_points import from_entry_points
from residuum.identification.errors import BadInput
from residuum.late_members import LateMembers
from residuum.nearest_names import known_names


def _of_other_packages() -> dict[str, type[Diagnoser]]:
    return {kind.name: kind for kind in from_entry_points("residuum.diagnosers")}


DIAGNOSERS = LateMembers[type[Diagnoser]](
    {
        "gate-actuator": ("residuum.diagnosis.diagnosers.gate_actuator", "GateActuator"),
        "gripping-pliers": ("residuum.diagnosis.diagnosers.gripping_pliers", "GrippingPliers"),
        "bearing": ("residuum.diagnosis.diagnosers.bearing", "Bearing"),
        "robust-residual": ("residuum.diagnosis.diagnosers.robust_residual", "RobustResidual"),
        "model-based": ("residuum.diagnosis.diagnosers.model_based", "ModelBased"),
    },
    _of_other_packages,
)
"""Name of a diagnoser (its class's `name`) → its class."""


def diagnoser_class(name: str) -> type[Diagnoser]:
    """The class of this name; BadInput lists the names there are."""
    if name not in DIAGNOSERS:
        raise BadInput(
            f"diagnoser {name!r}: there is none of this name; {known_names(name, DIAGNOSERS)}"
        )
    return DIAGNOSERS[name]


def untrained(kind: type[Diagnoser], **settings: Any) -> Diagnoser:
    """A new diagnoser of this class: its settings are the parameters of the class, and `method`.

    Raises
    ------
    BadInput
        A setting that the class has not; it names the diagnosers that have it.
    """
    known = _settings_of(kind)
    for setting, value in settings.items():
        if setting not in known:
            owners = [name for name, other in DIAGNOSERS.items() if setting in _settings_of(other)]
            instead = (
                f"only the {' and the '.join(owners)} diagnoser has it"
                if owners
                else known_names(setting, sorted(known), "it has")
            )
            raise BadInput(repr(value), setting, f"not a setting of {kind.name}; {instead}")
    of_class = {name: value for name, value in settings.items() if name != "method"}
    diagnoser = kind(**of_class)
    return diagnoser.with_settings(method=settings["method"]) if "method" in settings else diagnoser


def _settings_of(kind: type[Diagnoser]) -> set[str]:
    return {*inspect.signature(kind).parameters, "method"}
