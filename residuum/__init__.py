"""Residuum: condition monitoring for machines that have a model, and the identification behind it.

>>> import residuum as rs
>>> record = rs.simulate("gate-drive", effects={"coulomb-friction": "large"}, duration=20.0, seed=1)
>>> rs.model("gate-drive").compare(record).structured
True

Every name below is loaded when it is first used, so that the import itself costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from residuum.nearest_names import known_names

if TYPE_CHECKING:
    from residuum.identification.errors import (
        BadInput,
        BadModel,
        BadRecord,
        BadUnit,
        NotIdentifiable,
    )
    from residuum.library import control
    from residuum.library.catalogue import Catalogue, effects
    from residuum.library.comparison import Comparison
    from residuum.library.control import Controller
    from residuum.library.explanation import Explanation
    from residuum.library.finding import Finding
    from residuum.library.fmu import fmu
    from residuum.library.foreign_models import equations_model, linear_model
    from residuum.library.improvement import Estimation, Improvement
    from residuum.library.model import Model, model
    from residuum.library.monitor import Monitor, load_monitor, monitor
    from residuum.library.optional_package import MissingPackage
    from residuum.library.plant import Plant, identify, load_plant
    from residuum.library.reading import from_arrays, from_pandas, from_xarray, read
    from residuum.library.record import Record
    from residuum.library.residual import Residual, ResidualRun, residual
    from residuum.library.uncertainty import Uncertainty, uncertainty
    from residuum.library.virtual_machine import simulate

__all__ = [
    "BadInput",
    "BadModel",
    "BadRecord",
    "BadUnit",
    "Catalogue",
    "Comparison",
    "Controller",
    "Estimation",
    "Explanation",
    "Finding",
    "Improvement",
    "MissingPackage",
    "Model",
    "Monitor",
    "NotIdentifiable",
    "Plant",
    "Record",
    "Residual",
    "ResidualRun",
    "Uncertainty",
    "control",
    "effects",
    "equations_model",
    "fmu",
    "from_arrays",
    "from_pandas",
    "from_xarray",
    "identify",
    "linear_model",
    "load_monitor",
    "load_plant",
    "model",
    "monitor",
    "read",
    "residual",
    "simulate",
    "uncertainty",
]

_PLACES = {
    "identification.errors": ("BadInput", "BadModel", "BadRecord", "BadUnit", "NotIdentifiable"),
    "library.catalogue": ("Catalogue", "effects"),
    "library.comparison": ("Comparison",),
    "library.control": ("Controller",),
    "library.explanation": ("Explanation",),
    "library.finding": ("Finding",),
    "library.fmu": ("fmu",),
    "library.foreign_models": ("equations_model", "linear_model"),
    "library.improvement": ("Estimation", "Improvement"),
    "library.model": ("Model", "model"),
    "library.monitor": ("Monitor", "load_monitor", "monitor"),
    "library.optional_package": ("MissingPackage",),
    "library.plant": ("Plant", "identify", "load_plant"),
    "library.reading": ("from_arrays", "from_pandas", "from_xarray", "read"),
    "library.record": ("Record",),
    "library.residual": ("Residual", "ResidualRun", "residual"),
    "library.uncertainty": ("Uncertainty", "uncertainty"),
    "library.virtual_machine": ("simulate",),
}
_PLACE = {name: place for place, names in _PLACES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name == "control":
        return import_module("residuum.library.control")
    if name not in _PLACE:
        raise AttributeError(
            f"module 'residuum' has no attribute {name!r}; {known_names(name, __all__, 'it has')}"
        )
    found = getattr(import_module(f"residuum.{_PLACE[name]}"), name)
    # The next use meets it as any other name of the module.
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
