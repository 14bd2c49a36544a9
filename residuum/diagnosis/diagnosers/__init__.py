"""The diagnosers, one file each, by the name that the command line and the interface use."""

from residuum.diagnosis.diagnosers.base import Diagnoser
from residuum.diagnosis.diagnosers.bearing import Bearing
from residuum.diagnosis.diagnosers.gate_actuator import GateActuator
from residuum.diagnosis.diagnosers.gripping_pliers import GrippingPliers
from residuum.diagnosis.diagnosers.model_based import ModelBased
from residuum.diagnosis.diagnosers.robust_residual import RobustResidual
from residuum.identification.entry_points import from_entry_points
from residuum.identification.errors import BadInput
from residuum.nearest_names import known_names

DIAGNOSERS: dict[str, type[Diagnoser]] = {
    GateActuator.name: GateActuator,
    GrippingPliers.name: GrippingPliers,
    Bearing.name: Bearing,
    RobustResidual.name: RobustResidual,
    ModelBased.name: ModelBased,
}
for _found in from_entry_points("residuum.diagnosers"):
    DIAGNOSERS.setdefault(_found.name, _found)


def diagnoser_class(name: str) -> type[Diagnoser]:
    """The class of this name; BadInput lists the names there are."""
    if name not in DIAGNOSERS:
        raise BadInput(
            f"diagnoser {name!r}: there is none of this name; {known_names(name, DIAGNOSERS)}"
        )
    return DIAGNOSERS[name]
